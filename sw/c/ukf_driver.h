/**
 * @file
 * @brief Driver of the core: registers, words and steps. ukf_filter.h has the filter above it.
 *
 * The sequence of accesses, the checks and the errors are those of the driver in Python. Nothing is
 * allocated and nothing is global: one driver is one struct, and any number of them, for cores of
 * different sizes, may exist.
 *
 * An error that may have changed the core, or not, leaves it in doubt: `doubtful` is set, and all
 * that needs the core returns UKF_NOT_RECOVERED. enum ukf_result says which errors do.
 */
#ifndef UKF_DRIVER_H
#define UKF_DRIVER_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "ukf_port.h"
#include "ukf_real.h"

#ifdef __cplusplus
extern "C" {
#endif

/** Largest number of states, observations and noise terms of any core. */
#define UKF_MAX_SIZE 32u

/**
 * Sizes and addresses of a core: UKF_CORE_INITIALISER of the generated ukf_core.h, which has the
 * members in this order.
 */
struct ukf_core {
    uint32_t n; /**< States. */
    uint32_t q; /**< Process noise terms. */
    uint32_t r; /**< Observation noise terms. */
    uint32_t m; /**< Observations. */
    uint32_t exponent_bits;
    uint32_t fraction_bits;
    uint32_t covariance_form; /**< 0: square-root form, 1: covariance form. */
    uint32_t additive_q;      /**< Process noise is additive. */
    uint32_t additive_r;      /**< Observation noise is additive. */
    uint32_t has_f;           /**< The core evaluates the process model. */
    uint32_t has_h;           /**< The core evaluates the observation models. */
    uint32_t w0_low;          /**< Weight of sigma point 0, a binary64 number. */
    uint32_t w0_high;
    uint32_t sensors;         /**< Bit i: observation i is the first one of a sensor. */
    uint32_t models;          /**< Says which models the core evaluates; 0 if none. */
    uint32_t points;          /**< Sigma points, point 0 included. */
    uint32_t element_bytes;   /**< Bytes of a number. */
    uint32_t row_stride;      /**< Bytes from a row to the next. */
    /* Base addresses of the regions, in bytes; 0 if there is none. */
    uint32_t state_points;
    uint32_t process_noise_points;
    uint32_t observation_noise_points;
    uint32_t observation_points;
    uint32_t observation;
    uint32_t state;
    uint32_t factor;
    uint32_t covariance;
    uint32_t process_noise_factor;
    uint32_t observation_noise_factor;
    uint32_t inputs;
    /* Numbers of region U, which the models on the core take. */
    uint32_t input_count;
    uint32_t inputs_of_f; /**< As many of the first ones are for f. */
    uint32_t inputs_of_h; /**< As many of the last ones are for h. */
};

/** Rows that belong together, as those of a sensor. */
struct ukf_range {
    uint32_t first;
    uint32_t count;
};

/** A time-out for steps, in microseconds: most take some thousand clocks, but Linux has more to do. */
#define UKF_DEFAULT_TIMEOUT_US 1000000u

/** The first result that is not a code of the core. */
#define UKF_FIRST_OWN_RESULT 64u

/**
 * What came of a call. Below UKF_FIRST_OWN_RESULT it is what the core reports, its ERROR.CODE, also if
 * that is none of those named here. From there on it is what the driver and the filter find.
 *
 * Whatever a call that does not return UKF_OK was to read is not to be used.
 *
 * - Nothing has been done, and that is certain, with UKF_NOT_FINITE, UKF_SINGULAR_OBSERVATION,
 *   UKF_NOT_POSITIVE_DEFINITE, UKF_MODEL_F, UKF_MODEL_H, UKF_BAD_ARGUMENT, UKF_BAD_MODEL, and those
 *   that say that something has to be called first: UKF_NOT_OPEN, UKF_NOT_STARTED,
 *   UKF_NOT_RECOVERED. But a ukf_start() with UKF_NOT_FINITE is in doubt: x and P have been written
 *   before the core refuses Q or R. And of a ukf_iterate() the prediction may have been made.
 * - UKF_BUS_ERROR of a call that had only begun to read an estimate leaves no doubt either.
 * - Whether what was asked for has been done is open with UKF_BUS_ERROR otherwise, UKF_TIMEOUT,
 *   UKF_STEP_LOST, UKF_ILLEGAL_STEP, and codes that are not known: go on with ukf_recover().
 */
enum ukf_result {
    UKF_OK = 0,
    UKF_ILLEGAL_STEP = 1,          /**< A step was started out of sequence. */
    UKF_NOT_FINITE = 2,            /**< NaN, infinity or overflow; the estimate stays. */
    UKF_SINGULAR_OBSERVATION = 3,  /**< S is singular at fault.index, a row of all of z; it stays. */
    UKF_NOT_POSITIVE_DEFINITE = 4, /**< P is not, at fault.index, a row of x; it stays. */
    UKF_MODEL_F = 5,               /**< f on the core gives NaN or infinity, in row fault.index. */
    UKF_MODEL_H = 6,               /**< h on the core gives NaN or infinity, in row fault.index. */
    UKF_UNKNOWN_ERROR = UKF_FIRST_OWN_RESULT, /**< fault.code is 64 or more, which no core has. */
    UKF_TIMEOUT,        /**< The step did not end in time; it may end later. */
    UKF_STEP_LOST,      /**< Something else reset the core while the step ran. */
    UKF_BUS_ERROR,      /**< The core refused the access at fault.address. */
    UKF_WRONG_ID,       /**< ID is not that of a UKF core, or of another version of the map. */
    UKF_WRONG_SIZES,    /**< n, m, q, r or the rows of the sensors are others. */
    UKF_WRONG_FORMAT,   /**< Number format, form, kinds of noise or W0 are others. */
    UKF_BAD_ARGUMENT,   /**< An argument is out of range, not finite, or no covariance. */
    UKF_BAD_MODEL,      /**< A model failed or was not finite: fault.point, fault.index. */
    UKF_NOT_OPEN,       /**< ukf_open() has not succeeded. */
    UKF_NOT_STARTED,    /**< ukf_start() has not succeeded. */
    UKF_NOT_RECOVERED,  /**< An error has left a doubt: ukf_recover() has to succeed first. */
    UKF_ESTIMATE_LOST   /**< The doubt cannot be settled: begin anew with ukf_start(). */
};

/** Name of a result, for messages; "unknown error" for codes of the core without one: add the number. */
const char *ukf_result_name(enum ukf_result result);

/**
 * Details of the last call that the core, the bus or a model made fail; what does not apply is 0.
 */
struct ukf_fault {
    uint32_t step;     /**< UKF_STEP_... */
    uint32_t code;     /**< ERROR.CODE. */
    /**
     * ERROR.INDEX, a row of x or of the z of all sensors, whichever was updated; for UKF_BAD_MODEL a
     * row of what the model gave; for an input that was never set its place.
     */
    uint32_t index;
    uint32_t state;    /**< STATUS.STATE when a step was given up: UKF_STEP_... */
    uint32_t address;  /**< Byte address, of the access or of the register that is wrong. */
    uint32_t expected; /**< Value of the field that is wrong. */
    uint32_t found;
    uint32_t point;    /**< Number of the sigma point. */
};

/** A driver. Members are for reading. */
struct ukf_driver {
    const struct ukf_core *core;
    const struct ukf_port *port;
    uint32_t timeout_us;    /**< How long to wait for a step, in microseconds. */
    uint32_t pes;           /**< Processing elements that the core says it has. */
    struct ukf_fault fault; /**< Of the last call that failed. */
    bool open;              /**< ukf_driver_open() has succeeded. */
    bool doubtful;          /**< An error has left open what the core holds. */
    bool initialised;       /**< INIT has succeeded since the last reset. */
    bool mask_known;
    uint32_t mask;          /**< What MASK holds, if that is known; a bit for each row of all of z. */
    uint32_t step;          /**< The step that may have been started and may have ended. */
    bool dropping;          /**< That step has been reset, unless it had ended just before. */
    /**
     * The estimate is a prediction from `before`, whose covariance has not been factorised: the core
     * has the factor of that from before.
     */
    bool predicted;
    ukf_real before[UKF_MAX_SIZE];
    bool drawn;               /**< X surely holds sigma points of the estimate, */
    bool propagated;          /**< or those of a prediction, which an h on the core may take. */
    bool x_known;             /**< `x` has been read, and nothing since may have changed it. */
    ukf_real x[UKF_MAX_SIZE]; /**< The state in the core. */
};

/**
 * @brief Number of the first sigma point: 0, or 1 if W0 is 0.
 *
 * What has no weight has no influence: without W0 point 0 is neither read, sent through a model, nor
 * written. Its column in the memory map stays, and so does that in matrices of points here, unused.
 */
uint32_t ukf_core_first_point(const struct ukf_core *core);

/**
 * @brief Number of the sigma point to whose angles those of the others are wrapped.
 *
 * Point 0, which is at the mean. Without W0 it is the last point, from which others can be farther
 * away: by sqrt(M) + 1 / sqrt(M) standard deviations instead of sqrt(M) in the last element of x, w
 * and v together, of M elements, and no farther than from the mean in all others.
 */
uint32_t ukf_core_centre(const struct ukf_core *core);

/** @brief Number of sensors of a core. */
uint32_t ukf_core_sensors(const struct ukf_core *core);

/** @brief Rows of z that belong to a sensor, from 0; none if the core does not have it. */
struct ukf_range ukf_core_rows(const struct ukf_core *core, uint32_t sensor);

/** @brief Columns of the factor of R in the core: those of additive noise are shared by the sensors. */
uint32_t ukf_core_noise_columns(const struct ukf_core *core);

/**
 * @brief Compare the core with its description, then reset and enable it.
 *
 * @param driver     To be filled in; any contents.
 * @param core       What the core should be; must outlive the driver. The number of processing
 *                   elements does not matter.
 * @param port       Way to it; must outlive the driver.
 * @param timeout_us How long to wait for a step, in microseconds, more than 0.
 * @return UKF_BAD_ARGUMENT for a time-out of 0, a missing function, sizes out of range, or a format
 *         other than binary32 and binary64; UKF_WRONG_ID, UKF_WRONG_SIZES, UKF_WRONG_FORMAT;
 *         UKF_BUS_ERROR.
 */
enum ukf_result ukf_driver_open(struct ukf_driver *driver, const struct ukf_core *core,
                                const struct ukf_port *port, uint32_t timeout_us);

/**
 * @brief Whether the core may be used.
 * @return UKF_OK, UKF_NOT_OPEN or UKF_NOT_RECOVERED; so may all functions that follow.
 */
enum ukf_result ukf_driver_check(const struct ukf_driver *driver);

/**
 * @brief Reset and enable the core, to begin anew: no doubt matters.
 *
 * A running step is dropped. All that the core is to know must be written: x, the factors of P, Q
 * and R, and the gate.
 */
enum ukf_result ukf_driver_begin(struct ukf_driver *driver);

/**
 * @brief Settle a doubt: find out what the core has done.
 *
 * A step that may still run is waited for, and dropped if it does not end. A PREDICT that had broken
 * off is undone; other steps have happened or not. Without `initialised` afterwards the core has been
 * reset: what was being written must be written again, and the gate and the factors of Q and R.
 *
 * @return UKF_ESTIMATE_LOST if that cannot be found out; UKF_BUS_ERROR, after which it may be called
 *         again.
 */
enum ukf_result ukf_driver_recover(struct ukf_driver *driver);

/** @brief Go back to `before`, if the estimate is a prediction from it; resets the core. */
enum ukf_result ukf_driver_undo_predict(struct ukf_driver *driver);

/** @brief Run INIT if there was none since the last reset. */
enum ukf_result ukf_driver_initialise(struct ukf_driver *driver);

/**
 * @brief Have sigma points of the estimate in the buffer: SIG_GEN, which is free after an UPDATE.
 *
 * As all functions that run a step, it returns UKF_OK, one of the core's errors, UKF_TIMEOUT,
 * UKF_STEP_LOST or UKF_BUS_ERROR.
 */
enum ukf_result ukf_driver_generate(struct ukf_driver *driver);

/** @brief Give x, n numbers: read, unless it is known. It leaves no doubt. */
enum ukf_result ukf_driver_state(struct ukf_driver *driver, ukf_real *x);

/**
 * @brief Read the sigma points that ukf_driver_generate() has left. It leaves no doubt.
 *
 * Those up to n + 1 are read, and x unless it is known; the others are equal to x, as point 0 is.
 *
 * @param points n rows of `core->points` numbers; column k is point k, from ukf_core_first_point() on.
 */
enum ukf_result ukf_driver_points(struct ukf_driver *driver, ukf_real *points);

/**
 * @brief Write transformed sigma points and run PREDICT; x is read before, unless it is known.
 * @param points As ukf_driver_points(). They come back as the core holds them.
 */
enum ukf_result ukf_driver_predict(struct ukf_driver *driver, ukf_real *points);

/**
 * @brief Write what a sensor sees of the sigma points, and its z, and run its UPDATE.
 * @param sensor Its number, from 0.
 * @param points Its rows, with columns as in ukf_driver_points().
 * @param z      A number for each of its rows.
 * @param mask   Bit i takes its row i.
 * @param nis    Normalised innovation squared.
 * @param gated  Whether it exceeded the gate, so that the estimate stays.
 * @return UKF_BAD_ARGUMENT if there is no such sensor.
 */
enum ukf_result ukf_driver_update(struct ukf_driver *driver, uint32_t sensor,
                                  const ukf_real *points, const ukf_real *z, uint32_t mask,
                                  ukf_real *nis, bool *gated);

/** Numbers of region U, `core->input_count` each. */
struct ukf_inputs {
    ukf_real *wanted; /**< What the models are to take; not infinite. */
    ukf_real *held;   /**< What the core has been told of it; UKF_NOT_HELD at first. */
};

/** What `held` is where it is not known what the core has. */
#define UKF_NOT_HELD ((ukf_real)INFINITY)

/**
 * @brief Send sigma points of the estimate through f on the core, and predict: run F.
 *
 * The points are drawn unless they are there. Of the inputs of f those are written that have changed,
 * as for all steps of models on the core.
 *
 * @return UKF_MODEL_F if f gives NaN or infinity; the estimate stays.
 */
enum ukf_result ukf_driver_f(struct ukf_driver *driver, const struct ukf_inputs *inputs);

/**
 * @brief Read the sigma points that f on the core has given, after ukf_driver_f(). A failure leaves a
 * doubt: the prediction has been made.
 * @param points As ukf_driver_points().
 */
enum ukf_result ukf_driver_propagated(struct ukf_driver *driver, ukf_real *points);

/**
 * @brief Send sigma points through the h of a sensor on the core, and update: run H.
 *
 * The points are those of a prediction that has just been made. Otherwise, and after an update that
 * was rejected, they are drawn from the estimate. Arguments as ukf_driver_update(), and
 *
 * @param variant Which of the models of the sensor.
 * @param inputs  Numbers of region U.
 * @return UKF_MODEL_H if h gives NaN or infinity in a row that takes part; the estimate stays.
 *         UKF_ILLEGAL_STEP if the core has no such variant; UKF_BAD_ARGUMENT if no core can have it,
 *         or there is no such sensor.
 */
enum ukf_result ukf_driver_h(struct ukf_driver *driver, uint32_t sensor, uint32_t variant,
                             const struct ukf_inputs *inputs, const ukf_real *z, uint32_t mask,
                             ukf_real *nis, bool *gated);

/**
 * @brief Predict and update with models on the core: run ITERATE.
 *
 * Arguments as ukf_driver_h(). If neither f nor PREDICT has failed, but something after them, the
 * prediction stands.
 */
enum ukf_result ukf_driver_iterate(struct ukf_driver *driver, uint32_t sensor, uint32_t variant,
                                   const struct ukf_inputs *inputs, const ukf_real *z,
                                   uint32_t mask, ukf_real *nis, bool *gated);

/** @brief Run COVARIANCE and read P, n by n: its lower triangle, mirrored. */
enum ukf_result ukf_driver_covariance(struct ukf_driver *driver, ukf_real *P);

/** @brief Write the gate; infinity is off. What is finite stays so, at the format's largest. */
enum ukf_result ukf_driver_gate(struct ukf_driver *driver, ukf_real gate);

/** @brief Read CYCLES: clocks from start to end of the last step. */
enum ukf_result ukf_driver_cycles(struct ukf_driver *driver, uint32_t *cycles);

/**
 * @brief Read a part of a region, row by row. It leaves no doubt.
 * @param base    Address of its first number; of an upper left part the base address of the region,
 *                one of those in ukf_core.
 * @param rows    Rows of the part.
 * @param columns Columns of the part.
 * @param stride  Numbers from a row of `values` to the next.
 * @param values  Where they go.
 */
enum ukf_result ukf_driver_read(struct ukf_driver *driver, uint32_t base, uint32_t rows,
                                uint32_t columns, uint32_t stride, ukf_real *values);

/**
 * @brief Write a part of a region, row by row. Arguments as ukf_driver_read(). A write of x or of a
 * factor begins at the base address, by which the driver knows what it has to forget.
 *
 * A number is rounded to nearest, ties to even; below the smallest normal number it becomes 0.
 */
enum ukf_result ukf_driver_write(struct ukf_driver *driver, uint32_t base, uint32_t rows,
                                 uint32_t columns, uint32_t stride, const ukf_real *values);

/**
 * @brief Write the rows of a whole region that differ from what it holds, as words.
 *
 * Arguments as ukf_driver_write(), and
 *
 * @param before What the region holds; NULL if that is not known, then all rows are written.
 */
enum ukf_result ukf_driver_rewrite(struct ukf_driver *driver, uint32_t base, uint32_t rows,
                                   uint32_t columns, const ukf_real *values,
                                   const ukf_real *before);

/** @brief The number as the core of a format holds it. */
ukf_real ukf_driver_round(const struct ukf_driver *driver, ukf_real value);

#ifdef __cplusplus
}
#endif

#endif

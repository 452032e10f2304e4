/**
 * @file
 * @brief Unscented Kalman filter on the core: your models, and predict and update.
 *
 * The counterpart of the filter in Python, with the same sequence and the same numbers:
 *
 * @code
 * static const struct ukf_core core = UKF_CORE_INITIALISER;
 * static ukf_real work[UKF_WORK_LENGTH(UKF_N, UKF_M, UKF_Q, UKF_R, UKF_POINTS, UKF_INPUT_COUNT)];
 * struct ukf ukf;
 *
 * result = ukf_open(&ukf, &core, &port, &models, &options, work, sizeof work / sizeof work[0]);
 * if (result == UKF_OK) {
 *     result = ukf_start(&ukf, x0, P0, Q, R);
 * }
 * while (result == UKF_OK) {
 *     result = ukf_predict(&ukf, &input);
 *     if (result == UKF_OK) {
 *         result = ukf_update(&ukf, 0u, z, UKF_ALL);
 *     }
 *     if (result == UKF_OK) {
 *         result = ukf_state(&ukf, x);
 *     }
 *     if (result != UKF_OK) {
 *         result = ukf_recover(&ukf);
 *     }
 * }
 * @endcode
 *
 * With several sensors each update is of one of them, by its number, from 0: the order of its rows
 * in the core.
 *
 * The sizes are those of the struct ukf_core that is given, at run time, so one object code serves
 * any number of cores. All memory is that of struct ukf and of the caller's `work`.
 *
 * A core can have models of its own (core.has_f, core.has_h). Then they need not be given, and are
 * not called if they are; what they take besides x and noise is set with ukf_set_inputs(). With all
 * models on the core no sigma points cross the bus.
 *
 * Models in software are called for every sigma point that has a weight: with W0 = 0, the default, not for point
 * 0. Angles are wrapped to within half a turn of those of one point, ukf_core_centre(), so that no
 * mean is taken across the cut at +-pi. A column of a matrix of points has the number of the point.
 *
 * Matrices are row by row. What can be checked is checked before the first write. A call that fails
 * leaves estimate and settings as they were, but a predict that follows a predict begins with
 * ukf_redraw(), which stays; or it leaves open whether it has been done (enum ukf_result has the
 * list). Then driver.doubtful is set, and whatever needs the core returns UKF_NOT_RECOVERED until
 * ukf_recover() has found out, or ukf_start() or ukf_restore() has begun anew.
 */
#ifndef UKF_FILTER_H
#define UKF_FILTER_H

#include <stdbool.h>
#include <stdint.h>

#include "ukf_driver.h"

#ifdef __cplusplus
extern "C" {
#endif

/** Numbers that a filter needs as `work`. All arguments are sizes of the core. */
#define UKF_WORK_LENGTH(n, m, q, r, points, inputs) \
    (((n) + (m) + (q) + (r)) * (points) + (n) + (n) * (n) + 2u * ((q) * (q) + (r) * (r)) + \
     UKF_LARGER(UKF_LARGER(n, q), r) * UKF_LARGER(UKF_LARGER(n, q), r) + 2u * (inputs))
/** The larger one of two numbers without side effects. */
#define UKF_LARGER(a, b) ((a) > (b) ? (a) : (b))

/** Mask that takes all observations of a sensor. */
#define UKF_ALL UINT32_C(0xFFFFFFFF)

/**
 * @brief Process model: next = f(x, w, input).
 * @param context From struct ukf_models.
 * @param x       State, n numbers.
 * @param w       Process noise, q numbers; zeros if it is additive.
 * @param input   From ukf_predict().
 * @param next    Next state, n numbers; not x.
 * @return false if there is no result: the predict then ends with UKF_BAD_MODEL.
 */
typedef bool (*ukf_process_model)(void *context, const ukf_real *x, const ukf_real *w,
                                  const void *input, ukf_real *next);

/**
 * @brief Observation model of a sensor: z = h(x, v).
 * @param context From struct ukf_models.
 * @param x       State, n numbers.
 * @param v       The noise terms of this sensor; zeros if they are additive.
 * @param z       Observation, as many numbers as the sensor has rows.
 * @return false if there is no result: the update then ends with UKF_BAD_MODEL.
 */
typedef bool (*ukf_observation_model)(void *context, const ukf_real *x, const ukf_real *v,
                                      ukf_real *z);

/** A sensor: what is observed together. Its number of rows is that of the core. */
struct ukf_sensor {
    ukf_observation_model observe; /**< Not called, and may be NULL, if the core has h. */
    /** Noise terms. With additive noise this does not matter: there is one for each row, or none. */
    uint32_t terms;
    uint32_t angles; /**< Bit i: its row i is an angle, in radians. */
    /**
     * Which of the models that the core has for this sensor, 0 at first; it may change between updates.
     * UKF_ILLEGAL_STEP is what comes of one that the core does not have.
     */
    uint32_t variant;
};

/** The application. */
struct ukf_models {
    void *context;
    ukf_process_model process; /**< Not called, and may be NULL, if the core has f. */
    const struct ukf_sensor *sensors; /**< As many as the core has, in its order. */
    uint32_t state_angles; /**< Bit i: state i is an angle, in radians. The core knows those of its f. */
    /**
     * Told the input of each predict before all else, also with f on the core; NULL if nobody is. For
     * an h in C that takes some of it.
     */
    void (*on_predict)(void *context, const void *input);
};

/** How to run a filter. */
struct ukf_options {
    /** How long to wait for a step, in microseconds; more than 0. UKF_DEFAULT_TIMEOUT_US suits. */
    uint32_t timeout_us;
    /**
     * Whether every predict ends with ukf_redraw(), as one step: it is done if both are. The predicted
     * points do not have the spread of an additive process noise, so with such a noise this should be
     * true, unless the noise of one step is small.
     */
    bool redraw;
};

/** A filter. Members are for reading. Zeros are one that is not open. */
struct ukf {
    struct ukf_driver driver; /**< driver.fault has the details of the last failure. */
    const struct ukf_models *models;
    bool started;
    bool redraw;
    bool noise_written; /**< The core has the factors in `noise`. */
    bool transformed; /**< `X` holds points sent through f, which the next update may use. */
    bool gated;       /**< The last update was rejected: its NIS exceeded the gate. */
    ukf_real nis;     /**< NIS of the last update; NaN before, and after ukf_recover(). */
    ukf_real gate;
    /** Sends what is assigned: again in ukf_recover(), if that broke off; NULL if nothing is. */
    enum ukf_result (*unfinished)(struct ukf *ukf);
    ukf_real *X;      /**< Sigma points of the state, n by points; without W0 column 0 is unused, */
    ukf_real *Z;      /**< here as well: what a sensor sees of them, up to m by points, */
    ukf_real *W;      /**< sigma points of w, q by points, */
    ukf_real *V;      /**< sigma points of v, r by points. */
    ukf_real *x;          /**< What is assigned: x, n numbers, */
    ukf_real *L;          /**< a factor of P, n by n, */
    ukf_real *next_noise; /**< factors of Q and R, as the core has them. */
    ukf_real *noise;      /**< Factors of Q and R in use. */
    ukf_real *scratch;
    struct ukf_inputs inputs; /**< Numbers that the models on the core take. */
};

/**
 * @brief Find the core and check that it is the right one.
 * @param ukf     To be filled in.
 * @param core    Sizes and addresses; must outlive the filter.
 * @param port    Way to it; must outlive the filter.
 * @param models  The application, also its sensors; must outlive the filter.
 * @param options Options.
 * @param work    Memory of the filter.
 * @param length  Its numbers, UKF_WORK_LENGTH or more.
 * @return As ukf_driver_open(); UKF_BAD_ARGUMENT as well if a model is missing, the sensors do not have
 *         r noise terms together, or `work` is short. After another result than UKF_OK all other
 *         functions return UKF_NOT_OPEN.
 */
enum ukf_result ukf_open(struct ukf *ukf, const struct ukf_core *core, const struct ukf_port *port,
                         const struct ukf_models *models, const struct ukf_options *options,
                         ukf_real *work, uint32_t length);

/**
 * @brief Start from an estimate; also to start again, and after any error.
 * @param ukf An open filter.
 * @param x   Estimate, n numbers.
 * @param P   Its covariance, n by n.
 * @param Q   Covariance of w, q by q; NULL if q is 0.
 * @param R   Covariance of v, r by r; NULL if r is 0. It has a block for each sensor on its diagonal,
 *            in their order, and zeros beside them.
 * @return UKF_BAD_ARGUMENT if a number is not finite, also in the format of the core, a matrix not
 *         a covariance, or R not zero between sensors: the filter goes on as if not called. The
 *         errors of the core, also UKF_NOT_FINITE if Q or R is so large that INIT overflows, leave a
 *         doubt: start again.
 */
enum ukf_result ukf_start(struct ukf *ukf, const ukf_real *x, const ukf_real *P, const ukf_real *Q,
                          const ukf_real *R);

/**
 * @brief Set numbers that the models on the core take: region U, as the generated header names them.
 *
 * They are kept here, and written to the core before the next step that needs them, if they have
 * changed. Before the first predict those of f must have been set. Those of h that never have been set
 * are NaN, so an h that takes one gives UKF_MODEL_H.
 *
 * @param ukf    An open filter.
 * @param first  Place of the first one.
 * @param count  How many.
 * @param values The numbers.
 * @return UKF_BAD_ARGUMENT if there are no such places, or a number is not finite, also in the format
 *         of the core; all are as before then.
 */
enum ukf_result ukf_set_inputs(struct ukf *ukf, uint32_t first, uint32_t count,
                               const ukf_real *values);

/**
 * @brief Predict the state at the next step.
 * @param ukf   The filter.
 * @param input Handed to the process model; if the core has f, ukf_set_inputs() has its input.
 * @return UKF_BAD_ARGUMENT if the core has f, and an input of it, fault.index, has never been set.
 */
enum ukf_result ukf_predict(struct ukf *ukf, const void *input);

/** @brief Draw new sigma points from the estimate, so that an update after a predict uses them. */
enum ukf_result ukf_redraw(struct ukf *ukf);

/**
 * @brief Correct the state with an observation of a sensor.
 * @param ukf    The filter.
 * @param sensor Its number, from 0.
 * @param z      Observation, a number for each row of the sensor; those that were not sampled do not
 *               matter.
 * @param mask   Bit i: row i of the sensor was sampled. If none was, nothing happens.
 * @return UKF_BAD_ARGUMENT if a sampled observation is not finite, or there is no such sensor, or no
 *         core has such a variant.
 *         UKF_SINGULAR_OBSERVATION, without asking the core, if a row is one number for all sigma points
 *         and has no noise. UKF_OK also if the gate rejected the observation: then ukf->gated is true.
 */
enum ukf_result ukf_update(struct ukf *ukf, uint32_t sensor, const ukf_real *z, uint32_t mask);

/**
 * @brief Predict, then update: ukf_predict() with `input`, and ukf_update() with all else.
 *
 * If the core has f and h, it is one step of it, unless every predict redraws. Arguments are checked
 * before anything is done. If it fails, the prediction stands, unless it was f or the prediction that
 * failed: ukf_undo_predict() goes back.
 */
enum ukf_result ukf_iterate(struct ukf *ukf, const void *input, uint32_t sensor, const ukf_real *z,
                            uint32_t mask);

/** @brief Give the estimate, n numbers: read, unless it has been read and cannot have changed since. */
enum ukf_result ukf_state(struct ukf *ukf, ukf_real *x);

/** @brief Have the core compute the covariance of the estimate, and read it: n by n. */
enum ukf_result ukf_covariance(struct ukf *ukf, ukf_real *P);

/**
 * @brief Replace x, n numbers; P stays.
 * @return As all that replaces something, UKF_BAD_ARGUMENT as ukf_start().
 */
enum ukf_result ukf_set_state(struct ukf *ukf, const ukf_real *x);

/** @brief Replace P, n by n; x stays. */
enum ukf_result ukf_set_covariance(struct ukf *ukf, const ukf_real *P);

/**
 * @brief Replace Q, q by q, and R, r by r as for ukf_start(); the estimate stays.
 *
 * It begins with ukf_redraw(), and writes the rows of the factors that change.
 */
enum ukf_result ukf_set_noise(struct ukf *ukf, const ukf_real *Q, const ukf_real *R);

/**
 * @brief Replace the covariance of the noise of one sensor, as ukf_set_noise() does that of all.
 * @param ukf    The filter.
 * @param sensor Its number, from 0.
 * @param R      As many rows and columns as it has noise terms; NULL if it has none.
 * @return UKF_BAD_ARGUMENT also if there is no such sensor.
 */
enum ukf_result ukf_set_sensor_noise(struct ukf *ukf, uint32_t sensor, const ukf_real *R);

/** @brief Reject updates with a NIS above the gate, at least 0; infinity, at first, is off. */
enum ukf_result ukf_set_gate(struct ukf *ukf, ukf_real gate);

/**
 * @brief Read what it takes to come back to this estimate: x and the factor of P.
 *
 * Best after an update. After a predict it does what ukf_redraw() does.
 *
 * @param ukf The filter.
 * @param x   n numbers.
 * @param L   n by n.
 */
enum ukf_result ukf_save(struct ukf *ukf, ukf_real *x, ukf_real *L);

/**
 * @brief Begin anew from an estimate that was saved, with the same Q, R and gate; after any error.
 * @return UKF_BAD_ARGUMENT if a number is not finite: the filter goes on as if not called.
 */
enum ukf_result ukf_restore(struct ukf *ukf, const ukf_real *x, const ukf_real *L);

/**
 * @brief Go on after an error that has left open what the core has done.
 *
 * Afterwards estimate and settings agree again:
 *
 * - ukf_set_...(), ukf_start() or ukf_restore() that broke off has been done. If the core refuses it,
 *   it is given up; of a ukf_start() the estimate stays, with Q, R and gate from before. If there are
 *   none, UKF_NOT_STARTED is what follows.
 * - A predict that broke off has not happened, or has happened as a whole. So has an update.
 * - If the core had to be reset in a step, and the estimate was a prediction that had not been
 *   factorised, it is that from before the prediction.
 *
 * If it fails with a doubt it can be called again. Without a doubt it is legal and changes nothing
 * but the NIS.
 *
 * @return UKF_ESTIMATE_LOST if it cannot be found out what is left of the estimate. The core's
 *         refusals (UKF_NOT_FINITE, ...) are about the assignment that broke off, which is given up,
 *         and leave no doubt. UKF_BUS_ERROR, UKF_TIMEOUT and the like if the core cannot be reached.
 */
enum ukf_result ukf_recover(struct ukf *ukf);

/**
 * @brief Go back to the estimate from before the last predict.
 *
 * For a predict without redrawing whose covariance turns out not to be one, so that ukf_covariance()
 * or the next step fails. It is possible until the prediction has been factorised: by ukf_redraw(), a
 * predict, an update that was not gated, or a change of P, Q or R.
 *
 * @return UKF_BAD_ARGUMENT if there is no such predict.
 */
enum ukf_result ukf_undo_predict(struct ukf *ukf);

#ifdef __cplusplus
}
#endif

#endif

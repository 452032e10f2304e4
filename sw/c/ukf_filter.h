/**
 * @file
 * @brief Unscented Kalman filter on the core: your models, and predict and update.
 *
 * The counterpart of the filter in Python, with the same sequence and the same numbers:
 *
 * @code
 * static const struct ukf_core core = UKF_CORE_INITIALISER;
 * static ukf_real work[UKF_WORK_LENGTH(UKF_N, UKF_M, UKF_Q, UKF_R, UKF_POINTS)];
 * struct ukf ukf;
 *
 * result = ukf_open(&ukf, &core, &port, &models, &options, work, sizeof work / sizeof work[0]);
 * if (result == UKF_OK) {
 *     result = ukf_start(&ukf, x0, P0, Q, R);
 * }
 * while (result == UKF_OK) {
 *     result = ukf_predict(&ukf, &input);
 *     if (result == UKF_OK) {
 *         result = ukf_update(&ukf, z, UKF_ALL);
 *     }
 *     if (result == UKF_OK) {
 *         result = ukf_state(&ukf, x);
 *     }
 * }
 * @endcode
 *
 * The sizes are those of the struct ukf_core that is given, at run time, so one object code serves
 * any number of cores. All memory is that of struct ukf and of the caller's `work`.
 *
 * Matrices are row by row. What fails leaves the estimate as it was, except that after UKF_TIMEOUT
 * and UKF_BUS_ERROR a PREDICT may have moved x: go back with ukf_restore().
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
#define UKF_WORK_LENGTH(n, m, q, r, points) \
    (((n) + (m) + (q) + (r)) * (points) + UKF_LARGER(UKF_LARGER(n, q), r) * \
     UKF_LARGER(UKF_LARGER(n, q), r))
/** The larger one of two numbers without side effects. */
#define UKF_LARGER(a, b) ((a) > (b) ? (a) : (b))

/** Mask that takes all observations. */
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
 * @brief Observation model: z = h(x, v).
 * @param context From struct ukf_models.
 * @param x       State, n numbers.
 * @param v       Observation noise, r numbers; zeros if it is additive.
 * @param z       Observation, m numbers.
 * @return false if there is no result: the update then ends with UKF_BAD_MODEL.
 */
typedef bool (*ukf_observation_model)(void *context, const ukf_real *x, const ukf_real *v,
                                      ukf_real *z);

/** The application. */
struct ukf_models {
    void *context;
    ukf_process_model process;
    ukf_observation_model observe;
    uint32_t state_angles;       /**< Bit i: state i is an angle, in radians. */
    uint32_t observation_angles; /**< Bit i: observation i is an angle, in radians. */
};

/** How to run a filter. */
struct ukf_options {
    uint32_t timeout_us; /**< How long to wait for a step, in microseconds; more than 0. */
    /**
     * Whether every predict ends with ukf_redraw(). The predicted points do not have the spread of
     * an additive process noise, so with such a noise this should be true, unless the noise of one
     * step is small.
     */
    bool redraw;
};

/** A filter. Members are for reading. */
struct ukf {
    struct ukf_driver driver; /**< driver.fault has the details of the last failure. */
    const struct ukf_models *models;
    bool redraw;
    bool transformed; /**< `X` holds points sent through f, which the next update may use. */
    bool gated;       /**< The last update was rejected: its NIS exceeded the gate. */
    ukf_real nis;     /**< Normalised innovation squared of the last update; NaN before. */
    ukf_real gate;
    ukf_real *X;      /**< Sigma points of the state, n by points. */
    ukf_real *Z;      /**< Observations of the sigma points, m by points. */
    ukf_real *W;      /**< Sigma points of w, q by points. */
    ukf_real *V;      /**< Sigma points of v, r by points. */
    ukf_real *scratch;
};

/**
 * @brief Find the core and check that it is the right one.
 * @param ukf     To be filled in.
 * @param core    Sizes and addresses; must outlive the filter.
 * @param port    Way to it; must outlive the filter.
 * @param models  The application; must outlive the filter.
 * @param options Options.
 * @param work    Memory of the filter.
 * @param length  Its numbers, UKF_WORK_LENGTH or more.
 * @return As ukf_driver_open(); UKF_BAD_ARGUMENT as well if a model is missing or `work` is short.
 */
enum ukf_result ukf_open(struct ukf *ukf, const struct ukf_core *core, const struct ukf_port *port,
                         const struct ukf_models *models, const struct ukf_options *options,
                         ukf_real *work, uint32_t length);

/**
 * @brief Start from an estimate; also to start again.
 * @param ukf An open filter.
 * @param x   Estimate, n numbers.
 * @param P   Its covariance, n by n.
 * @param Q   Covariance of w, q by q; NULL if q is 0.
 * @param R   Covariance of v, r by r; NULL if r is 0.
 * @return UKF_BAD_ARGUMENT if a number is not finite or a matrix not a covariance; the errors of the
 *         core.
 */
enum ukf_result ukf_start(struct ukf *ukf, const ukf_real *x, const ukf_real *P, const ukf_real *Q,
                          const ukf_real *R);

/** @brief Predict the state at the next step. `input` is handed to the process model. */
enum ukf_result ukf_predict(struct ukf *ukf, const void *input);

/** @brief Draw new sigma points from the estimate, so that an update after a predict uses them. */
enum ukf_result ukf_redraw(struct ukf *ukf);

/**
 * @brief Correct the state with an observation.
 * @param ukf  The filter.
 * @param z    Observation, m numbers; those that were not sampled do not matter.
 * @param mask Bit i: observation i was sampled. If none was, nothing happens.
 * @return UKF_BAD_ARGUMENT if a sampled observation is not finite. UKF_OK also if the gate rejected
 *         the observation: then ukf->gated is true.
 */
enum ukf_result ukf_update(struct ukf *ukf, const ukf_real *z, uint32_t mask);

/** @brief Read the estimate, n numbers. */
enum ukf_result ukf_state(struct ukf *ukf, ukf_real *x);

/** @brief Have the core compute the covariance of the estimate, and read it: n by n. */
enum ukf_result ukf_covariance(struct ukf *ukf, ukf_real *P);

/** @brief Replace x, n numbers; P stays. */
enum ukf_result ukf_set_state(struct ukf *ukf, const ukf_real *x);

/** @brief Replace P, n by n; x stays. */
enum ukf_result ukf_set_covariance(struct ukf *ukf, const ukf_real *P);

/** @brief Replace Q, q by q, and R, r by r; the estimate stays. */
enum ukf_result ukf_set_noise(struct ukf *ukf, const ukf_real *Q, const ukf_real *R);

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
 * @brief After an error: reset the core and go on from an estimate that was saved.
 *
 * Q, R and the gate are in the core still, unless it lost power: then use ukf_start().
 */
enum ukf_result ukf_restore(struct ukf *ukf, const ukf_real *x, const ukf_real *L);

#ifdef __cplusplus
}
#endif

#endif

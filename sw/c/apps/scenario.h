/**
 * @file
 * @brief Parameters and sensor data of a run, as `ukf export` writes them.
 */
#ifndef UKF_SCENARIO_H
#define UKF_SCENARIO_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/**
 * A run. Step k predicts with input k, then updates with every sensor of which something was sampled,
 * in the order of their rows. Matrices are row by row.
 */
struct ukf_scenario {
    uint32_t n;        /**< States. */
    uint32_t m;        /**< Observations, of all sensors. */
    uint32_t q;        /**< Process noise terms. */
    uint32_t r;        /**< Observation noise terms. */
    uint32_t inputs;   /**< Numbers of an input. */
    uint32_t steps;
    bool redraw;       /**< See struct ukf_options. */
    double interval;   /**< Of the steps, s; NaN if they are not at equal intervals. */
    const double *x0;  /**< First estimate, n. */
    const double *P0;  /**< Its covariance, n by n. */
    const double *Q;   /**< Covariance of w, q by q. */
    const double *R;   /**< Covariance of v, r by r: a block for each sensor. */
    const double *input;       /**< steps by inputs. */
    const double *measurement; /**< steps by m; 0 where not sampled. */
    const uint32_t *sampled;   /**< steps; bit i: observation i was sampled. */
    /* For the models that the core has. */
    uint32_t sensors;           /**< Sensors. */
    uint32_t core_inputs;       /**< Numbers that these models take beside x and noise; 0 if none. */
    const double *core_input;   /**< steps by core_inputs; see ukf_set_inputs(). */
    const uint32_t *terms;      /**< Noise terms of each sensor. */
    const uint32_t *variant;    /**< steps by sensors: which model of a sensor; see struct ukf_sensor. */
};

/** What came of a step. */
struct ukf_record {
    double nis;      /**< Normalised innovation squared, of all sensors; NaN if nothing was sampled. */
    uint32_t result; /**< enum ukf_result. */
    uint32_t gated;  /**< 1 if an update was rejected. */
};

#ifdef __cplusplus
}
#endif

#endif

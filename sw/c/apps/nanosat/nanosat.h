/**
 * @file
 * @brief Attitude of a nanosatellite from gyroscope, accelerometer and magnetometer.
 *
 * The application of Soh and Wu (2018). The state is (q1, q2, q3, q0, beta): attitude quaternion with
 * the scalar last, and gyroscope bias in rad/s. The counterpart of ukf_sw.problems.systems.nanosat in
 * Python, where the readings of the papers are explained; every operation is in the same order, so in
 * double the results are equal to the last bit. (Compile with -ffp-contract=off.)
 */
#ifndef NANOSAT_H
#define NANOSAT_H

#include <stdbool.h>

#include "scenario.h"
#include "ukf_filter.h"

#ifdef __cplusplus
extern "C" {
#endif

#define NANOSAT_STATES 7u
#define NANOSAT_OBSERVATIONS 6u
#define NANOSAT_INPUTS 3u

/** What the models know. */
struct nanosat {
    ukf_real dt; /**< Sampling interval, s. */
};

/**
 * @brief Process model, dead reckoning with the gyroscope (equations 37 and 38).
 *
 * A ukf_process_model: `context` is a struct nanosat, `w` has 4 quaternion rates in 1/s and 3 bias
 * rates in rad/s^2, `input` is the gyroscope's sample, 3 numbers in rad/s.
 */
bool nanosat_process(void *context, const ukf_real *x, const ukf_real *w, const void *input,
                     ukf_real *next);

/**
 * @brief Observation model, directions of gravity and of the magnetic field (equation 39).
 *
 * A ukf_observation_model: `v` and `z` are accelerometer and magnetometer, 3 numbers each, in units
 * of the local field.
 */
bool nanosat_observe(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z);

/** @brief The same for the accelerometer alone, 3 numbers. */
bool nanosat_observe_gravity(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z);

/** @brief The same for the magnetometer alone, 3 numbers. */
bool nanosat_observe_field(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z);

/** A run of the filter over a scenario. */
struct nanosat_run {
    const struct ukf_core *core;
    const struct ukf_port *port;
    const struct ukf_scenario *scenario;
    uint32_t timeout_us; /**< How long to wait for a step of the core, in microseconds. */
    bool covariances;    /**< Whether P is read after each step: a step of the core, and words. */
    /** Called after each step, with its number, the estimate, and P or NULL; NULL is nobody. */
    void (*on_step)(void *context, uint32_t step, const ukf_real *x, const ukf_real *P,
                    const struct ukf_record *record);
    void *context; /**< First argument of on_step. */
    ukf_real P[NANOSAT_STATES * NANOSAT_STATES]; /**< Covariance as last read; at the end, the last. */
    uint32_t errors;        /**< Steps that failed. */
    uint32_t recoveries;    /**< Failures after which the filter had to be recovered. */
    struct ukf_fault fault; /**< Details of the last failure. */
};

/**
 * @brief Run the filter over all samples.
 *
 * Accelerometer and magnetometer are one sensor of the core, or two.
 *
 * When a step fails the rest of the sample is dropped. If the core or the bus failed, the filter is
 * recovered before the next, and begins anew if the estimate is lost. If that fails, the run ends.
 *
 * @return UKF_OK if the run came to its end; otherwise what ended it.
 */
enum ukf_result nanosat_execute(struct nanosat_run *run);

#ifdef __cplusplus
}
#endif

#endif

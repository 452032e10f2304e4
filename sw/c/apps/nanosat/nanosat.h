/**
 * @file
 * @brief Attitude of a nanosatellite from gyroscope, accelerometer and magnetometer.
 *
 * The application of Soh and Wu (2018). The state is (q1, q2, q3, q0, beta): attitude quaternion with
 * the scalar last, and gyroscope bias in rad/s. The C counterpart of sw/ukf_sw/problems/systems/nanosat.py,
 * where the readings of the papers are explained; every operation is in the same order, so in double
 * the results are equal to the last bit. (Compile with -ffp-contract=off.)
 */
#ifndef NANOSAT_H
#define NANOSAT_H

#include <stdbool.h>

#include "scenario.h"
#include "ukf_filter.h"

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

/** How to run the filter on a scenario. */
struct nanosat_run {
    const struct ukf_core *core;
    const struct ukf_port *port;
    const struct ukf_scenario *scenario;
    uint32_t timeout_us;    /**< How long to wait for a step of the core, in microseconds. */
    uint32_t save_interval; /**< Steps from one saved estimate to the next; 0 is none. */
    /** Called after each step, with its number and the estimate; NULL is nobody. */
    void (*report)(void *context, uint32_t step, const ukf_real *x,
                   const struct ukf_record *record);
    void *report_context;
    ukf_real P[NANOSAT_STATES * NANOSAT_STATES]; /**< Covariance at the end. */
    uint32_t errors;        /**< Steps that failed. */
    uint32_t recoveries;    /**< Failures after which it went on from the saved estimate. */
    struct ukf_fault fault; /**< Details of the last failure. */
};

/**
 * @brief Run the filter over all samples.
 *
 * When a step fails the sample is dropped. The estimate from before it is good still, unless the core
 * or the bus failed: then the last saved estimate is restored. If that fails as well, or nothing has
 * been saved, the run ends.
 *
 * @return UKF_OK if the run came to its end; otherwise what ended it.
 */
enum ukf_result nanosat_run(struct nanosat_run *run);

#endif

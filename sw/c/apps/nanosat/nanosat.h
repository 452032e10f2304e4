/**
 * @file
 * @brief Attitude of a nanosatellite from gyroscope, accelerometer and magnetometer.
 *
 * The application of Soh and Wu (2018). The state is (q1, q2, q3, q0, beta): attitude quaternion with
 * the scalar last, and gyroscope bias in rad/s. The counterpart of ukf_sw.problems.systems.nanosat in
 * Python, where the readings of the papers are explained; every operation is in the same order, so in
 * double the results are equal to the last bit. (Compile with -ffp-contract=off.) It is an application
 * for the programs of the folder above: accelerometer and magnetometer are one sensor of the core, or two.
 */
#ifndef NANOSAT_H
#define NANOSAT_H

#include <stdbool.h>

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

#ifdef __cplusplus
}
#endif

#endif

/**
 * @file
 * @brief What the files of driver and filter share. It is not for applications.
 */
#ifndef UKF_INTERNAL_H
#define UKF_INTERNAL_H

#include <stdbool.h>
#include <stdint.h>

#include "ukf_filter.h"

#ifdef __cplusplus
extern "C" {
#endif

/** @brief Whether a step that ended so has changed nothing. */
bool ukf_is_refusal(enum ukf_result result);

/** @brief Note that what was done may have changed the core, unless it is certain that it has not. */
enum ukf_result ukf_driver_judged(struct ukf_driver *driver, enum ukf_result result);

/** @brief Run a step that is not one of a sensor. @param status STATUS at its end. */
enum ukf_result ukf_driver_run(struct ukf_driver *driver, uint32_t step, uint32_t *status);

/**
 * @brief Run a step that ends with an UPDATE, and read the NIS.
 *
 * x is known afterwards if it was before, and the gate has rejected the update.
 *
 * @param step UKF_STEP_UPDATE, _H or _ITERATE; all other arguments as for these.
 */
enum ukf_result ukf_driver_correct(struct ukf_driver *driver, uint32_t step, uint32_t sensor,
                                   uint32_t variant, ukf_real *nis, bool *gated);

/** @brief Read STATUS; a failure leaves a doubt. */
enum ukf_result ukf_driver_status(struct ukf_driver *driver, uint32_t *status);

/** @brief Write MASK with other bits for the rows of a sensor, unless they are there; others stay. */
enum ukf_result ukf_driver_mask(struct ukf_driver *driver, struct ukf_range rows, uint32_t mask);

/** @brief Whether the bits of two numbers in the format of the core are equal. */
bool ukf_driver_same(const struct ukf_driver *driver, ukf_real value, ukf_real other);

/** @brief Whether a core has a sensor, and can have a variant of its model. */
bool ukf_driver_has(const struct ukf_driver *driver, uint32_t sensor, uint32_t variant);

/** @brief Noise terms of a sensor, which are rows of V and of R. */
struct ukf_range ukf_terms_of(const struct ukf_core *core, const struct ukf_models *models,
                              uint32_t sensor);

/** @brief Send the sigma points in X through the process model of the application, and wrap angles. */
enum ukf_result ukf_software_f(struct ukf *ukf, const void *input);

/**
 * @brief Send the sigma points in X through the observation model of a sensor, into Z.
 * @param used Bit i: its row i takes part. Others become zero.
 * @param z    Its observation, of which angles are wrapped, as those of Z.
 */
enum ukf_result ukf_software_h(struct ukf *ukf, uint32_t sensor, uint32_t used, ukf_real *z);

/**
 * @brief Refuse a row of Z that is one number for all sigma points and has no noise.
 *
 * Its variance is zero, but the core would find the rounding error of its mean, and nothing to
 * compare that with. Of a row of zeros it finds zero, of one that overflows that it is not finite,
 * and says so itself.
 *
 * @param used As for ukf_software_h().
 * @return UKF_SINGULAR_OBSERVATION.
 */
enum ukf_result ukf_software_varies(struct ukf *ukf, uint32_t sensor, uint32_t used);

#ifdef __cplusplus
}
#endif

#endif

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "ukf_driver.h"
#include "ukf_internal.h"
#include "ukf_registers.h"

/* Inputs. */

/** Write those of some places that have changed. */
static enum ukf_result put_inputs(struct ukf_driver *driver, const struct ukf_inputs *inputs,
                                  uint32_t first, uint32_t count)
{
    const struct ukf_core *core = driver->core;
    const ukf_real *wanted = inputs->wanted + first;
    ukf_real *held = inputs->held + first;

    /* None of them is known until all have been written. */
    for (uint32_t i = 0; i < count; i++) {
        if (!ukf_driver_same(driver, wanted[i], held[i])) {
            held[i] = UKF_NOT_HELD;
        }
    }
    for (uint32_t i = 0; i < count; i++) {
        if (!ukf_driver_same(driver, wanted[i], held[i])) {
            const uint32_t address = core->inputs + (first + i) * core->element_bytes;
            const enum ukf_result result = ukf_driver_write(driver, address, 1u, 1u, 1u, &wanted[i]);

            if (result != UKF_OK) {
                return result;
            }
        }
    }
    memcpy(held, wanted, count * sizeof *held);
    return UKF_OK;
}

static enum ukf_result put_inputs_of_f(struct ukf_driver *driver, const struct ukf_inputs *inputs)
{
    return put_inputs(driver, inputs, 0u, driver->core->inputs_of_f);
}

static enum ukf_result put_inputs_of_h(struct ukf_driver *driver, const struct ukf_inputs *inputs)
{
    const uint32_t count = driver->core->inputs_of_h;

    return put_inputs(driver, inputs, driver->core->input_count - count, count);
}

/* Steps. */

/** Have sigma points of the estimate in X. */
static enum ukf_result draw(struct ukf_driver *driver)
{
    const enum ukf_result result = ukf_driver_check(driver);

    return result == UKF_OK && !driver->drawn ? ukf_driver_generate(driver) : result;
}

bool ukf_driver_has(const struct ukf_driver *driver, uint32_t sensor, uint32_t variant)
{
    const uint32_t largest = UKF_CONTROL_VARIANT_MASK >> UKF_CONTROL_VARIANT_SHIFT;

    return ukf_core_rows(driver->core, sensor).count > 0u && variant <= largest;
}

/** Write z and the mask of a sensor. */
static enum ukf_result put_observation(struct ukf_driver *driver, uint32_t sensor,
                                       const ukf_real *z, uint32_t mask)
{
    const struct ukf_core *core = driver->core;
    const struct ukf_range rows = ukf_core_rows(core, sensor);
    const enum ukf_result result = ukf_driver_write(
        driver, core->observation + rows.first * core->row_stride, rows.count, 1u, 1u, z);

    return result == UKF_OK ? ukf_driver_mask(driver, rows, mask) : result;
}

/** Note the estimate that a prediction is about to be made from; x is read unless it is known. */
static enum ukf_result keep_estimate(struct ukf_driver *driver)
{
    ukf_real x[UKF_MAX_SIZE];
    enum ukf_result result = UKF_OK;

    if (!driver->predicted) {
        result = ukf_driver_state(driver, x);
    }
    if (result == UKF_OK && !driver->predicted) {
        memcpy(driver->before, x, driver->core->n * sizeof *x);
        driver->predicted = true;
    }
    driver->x_known = driver->x_known && result != UKF_OK;
    return result;
}

enum ukf_result ukf_driver_f(struct ukf_driver *driver, const struct ukf_inputs *inputs)
{
    enum ukf_result result = draw(driver);
    uint32_t status;

    if (result == UKF_OK) {
        result = put_inputs_of_f(driver, inputs);
    }
    if (result == UKF_OK) {
        result = keep_estimate(driver);
    }
    if (result != UKF_OK) {
        return result;
    }
    result = ukf_driver_run(driver, UKF_STEP_F, &status);
    if (ukf_is_refusal(result)) {
        driver->predicted = false;
    }
    return result;
}

enum ukf_result ukf_driver_propagated(struct ukf_driver *driver, ukf_real *points)
{
    const struct ukf_core *core = driver->core;
    const uint32_t first = ukf_core_first_point(core);

    return ukf_driver_judged(
        driver, ukf_driver_read(driver, core->state_points + first * core->element_bytes, core->n,
                                core->points - first, core->points, points + first));
}

enum ukf_result ukf_driver_h(struct ukf_driver *driver, uint32_t sensor, uint32_t variant,
                             const struct ukf_inputs *inputs, const ukf_real *z, uint32_t mask,
                             ukf_real *nis, bool *gated)
{
    enum ukf_result result = ukf_driver_check(driver);
    bool propagated;
    bool known;

    if (result == UKF_OK && !ukf_driver_has(driver, sensor, variant)) {
        result = UKF_BAD_ARGUMENT;
    }
    if (result == UKF_OK && !driver->propagated) {
        result = draw(driver);
    }
    if (result == UKF_OK) {
        result = put_inputs_of_h(driver, inputs);
    }
    if (result == UKF_OK) {
        result = put_observation(driver, sensor, z, mask);
    }
    if (result != UKF_OK) {
        return result;
    }
    propagated = driver->propagated;
    known = driver->x_known;
    result = ukf_driver_correct(driver, UKF_STEP_H, sensor, variant, nis, gated);
    if (result == UKF_MODEL_H) { /* h leaves X as it is */
        driver->propagated = propagated;
        driver->x_known = known;
    }
    return result;
}

/** After an ITERATE that was refused: whether it was before or after its prediction. */
static enum ukf_result find_prediction(struct ukf_driver *driver, enum ukf_result refusal)
{
    uint32_t status;
    const enum ukf_result result = ukf_driver_status(driver, &status);

    if (result != UKF_OK) {
        driver->step = UKF_STEP_ITERATE; /* of which recovering has to find that out */
        return result;
    }
    driver->predicted = (status & UKF_STATUS_RESIDUALS_MASK) != 0u;
    driver->propagated = driver->predicted && refusal == UKF_MODEL_H;
    return refusal;
}

enum ukf_result ukf_driver_iterate(struct ukf_driver *driver, uint32_t sensor, uint32_t variant,
                                   const struct ukf_inputs *inputs, const ukf_real *z,
                                   uint32_t mask, ukf_real *nis, bool *gated)
{
    enum ukf_result result = ukf_driver_check(driver);

    if (result == UKF_OK && !ukf_driver_has(driver, sensor, variant)) {
        result = UKF_BAD_ARGUMENT;
    }
    if (result == UKF_OK) {
        result = draw(driver);
    }
    if (result == UKF_OK) {
        result = put_inputs_of_f(driver, inputs);
    }
    if (result == UKF_OK) {
        result = put_inputs_of_h(driver, inputs);
    }
    if (result == UKF_OK) {
        result = put_observation(driver, sensor, z, mask);
    }
    if (result == UKF_OK) {
        result = keep_estimate(driver);
    }
    if (result != UKF_OK) {
        return result;
    }
    result = ukf_driver_correct(driver, UKF_STEP_ITERATE, sensor, variant, nis, gated);
    return ukf_is_refusal(result) ? find_prediction(driver, result) : result;
}

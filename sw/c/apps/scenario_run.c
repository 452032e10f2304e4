#include "scenario_run.h"

#include <math.h>
#include <stddef.h>

#include "application.h"

/** A size that an array may have. */
#define AT_LEAST_1(size) ((size) > 0u ? (size) : 1u)

/** Numbers of a scenario in the type of the filter. */
static void convert(const double *from, uint32_t count, ukf_real *to)
{
    for (uint32_t i = 0; i < count; i++) {
        to[i] = (ukf_real)from[i];
    }
}

static enum ukf_result start(struct ukf *ukf, const struct ukf_scenario *scenario)
{
    /* Of large cores they are more than a small stack holds. */
    static ukf_real x[UKF_N];
    static ukf_real P[UKF_N * UKF_N];
    static ukf_real Q[AT_LEAST_1(UKF_Q * UKF_Q)];
    static ukf_real R[AT_LEAST_1(UKF_R * UKF_R)];

    convert(scenario->x0, scenario->n, x);
    convert(scenario->P0, scenario->n * scenario->n, P);
    convert(scenario->Q, scenario->q * scenario->q, Q);
    convert(scenario->R, scenario->r * scenario->r, R);
    return ukf_start(ukf, x, P, Q, R);
}

#if UKF_HAS_H
/** Sensors whose models the core has; their variants are those of the step. */
static struct ukf_sensor sensors_on_core[UKF_M];

static void choose_variants(const struct ukf_scenario *scenario, uint32_t k)
{
    for (uint32_t i = 0; i < scenario->sensors; i++) {
        sensors_on_core[i].variant = scenario->variant[(size_t)k * scenario->sensors + i];
    }
}
#endif

/** Rows of a sensor that were sampled, as a mask for it. */
static uint32_t mask_of(const struct ukf *ukf, uint32_t sensor, uint32_t sampled)
{
    const struct ukf_range rows = ukf_core_rows(ukf->driver.core, sensor);

    return sampled >> rows.first & (UKF_ALL >> (UKF_MAX_SIZE - rows.count));
}

/** Predict, and update with each sensor of which something was sampled. */
static enum ukf_result filter(struct ukf *ukf, const ukf_real *u, const ukf_real *z,
                              uint32_t sampled, struct ukf_record *record)
{
    const uint32_t sensors = ukf_core_sensors(ukf->driver.core);
    enum ukf_result result = UKF_OK;
    bool predicted = false;

    for (uint32_t i = 0; result == UKF_OK && i < sensors; i++) {
        const uint32_t first = ukf_core_rows(ukf->driver.core, i).first;
        const uint32_t mask = mask_of(ukf, i, sampled);

        if (mask == 0u) {
            continue;
        }
        result = predicted ? ukf_update(ukf, i, z + first, mask)
                           : ukf_iterate(ukf, u, i, z + first, mask);
        predicted = true;
        if (result == UKF_OK) {
            record->nis = (ukf_is_number(record->nis) ? record->nis : 0.0) + (double)ukf->nis;
            record->gated = record->gated != 0u || ukf->gated;
        }
    }
    return predicted ? result : ukf_predict(ukf, u);
}

/** One step: filter the sample, and read the estimate. */
static enum ukf_result iterate(struct ukf *ukf, const struct ukf_scenario *scenario, uint32_t k,
                               ukf_real *x, struct ukf_record *record)
{
    static ukf_real on_core[AT_LEAST_1(UKF_INPUT_COUNT)];
    ukf_real u[UKF_MAX_SIZE];
    ukf_real z[UKF_M];
    enum ukf_result result;

    convert(scenario->input + (size_t)k * scenario->inputs, scenario->inputs, u);
    convert(scenario->measurement + (size_t)k * scenario->m, scenario->m, z);
    convert(scenario->core_input + (size_t)k * UKF_INPUT_COUNT, UKF_INPUT_COUNT, on_core);
    result = ukf_set_inputs(ukf, 0u, UKF_INPUT_COUNT, on_core);
#if UKF_HAS_H
    choose_variants(scenario, k);
#endif
    if (result == UKF_OK) {
        result = filter(ukf, u, z, scenario->sampled[k], record);
    }
    return result == UKF_OK ? ukf_state(ukf, x) : result;
}

/** Get ready for the next sample; from the first estimate, if that of the core is lost. */
static enum ukf_result recover(struct ukf *ukf, const struct ukf_scenario *scenario)
{
    const enum ukf_result result = ukf_recover(ukf);

    return result == UKF_ESTIMATE_LOST ? start(ukf, scenario) : result;
}

/** Run all steps. */
static enum ukf_result execute(struct ukf_run *run, struct ukf *ukf)
{
    ukf_real x[UKF_N];
    enum ukf_result result = start(ukf, run->scenario);

    if (result == UKF_OK) {
        result = ukf_state(ukf, x);
    }
    for (uint32_t k = 0; result == UKF_OK && k < run->scenario->steps; k++) {
        struct ukf_record record = {.nis = NAN};

        record.result = iterate(ukf, run->scenario, k, x, &record);
        if (record.result != UKF_OK) {
            record.nis = NAN;
            record.gated = 0u;
            run->errors++;
            run->fault = ukf->driver.fault;
            if (ukf->driver.doubtful) {
                result = recover(ukf, run->scenario);
                run->recoveries += result == UKF_OK;
            }
            if (result == UKF_OK) {
                result = ukf_state(ukf, x);
            }
        }
        if (result == UKF_OK && run->covariances) {
            result = ukf_covariance(ukf, run->P);
        }
        if (run->on_step != NULL) {
            run->on_step(run->context, k, x, run->covariances ? run->P : NULL, &record);
        }
    }
    return result == UKF_OK ? ukf_covariance(ukf, run->P) : result;
}

enum ukf_result ukf_run_scenario(struct ukf_run *run)
{
    static const struct ukf_core core = UKF_CORE_INITIALISER;
    static ukf_real work[UKF_WORK_LENGTH(UKF_N, UKF_M, UKF_Q, UKF_R, UKF_POINTS, UKF_INPUT_COUNT)];
    const struct ukf_scenario *scenario = run->scenario;
    const struct ukf_options options = {
        .timeout_us = run->timeout_us, .redraw = scenario->redraw};
    struct ukf_models models = {0};
    struct ukf ukf;
    enum ukf_result result;

    run->errors = 0;
    run->recoveries = 0;
    run->fault = (struct ukf_fault){0};
    run->complaint = NULL;
    if (scenario->n != UKF_N || scenario->m != UKF_M || scenario->q != UKF_Q ||
        scenario->r != UKF_R || scenario->inputs > UKF_MAX_SIZE ||
        scenario->sensors != ukf_core_sensors(&core)) {
        run->complaint = "the scenario is not for a core of these sizes";
        return UKF_BAD_ARGUMENT;
    }
    if (scenario->core_inputs != UKF_INPUT_COUNT) {
        run->complaint = "the scenario is not for the models that the core has";
        return UKF_BAD_ARGUMENT;
    }
#if !(UKF_HAS_F && UKF_HAS_H)
    {
        const struct ukf_models *application = ukf_application(scenario);

        if (application == NULL) {
            run->complaint = "the models are not for these sizes: ukf_application() gives none";
            return UKF_BAD_ARGUMENT;
        }
        models = *application;
    }
#endif
#if UKF_HAS_H
    for (uint32_t i = 0; i < scenario->sensors; i++) {
        sensors_on_core[i] = (struct ukf_sensor){.terms = scenario->terms[i]};
    }
    models.sensors = sensors_on_core;
#endif
    result = ukf_open(&ukf, &core, run->port, &models, &options, work,
                      (uint32_t)(sizeof work / sizeof work[0]));
    if (result == UKF_BAD_ARGUMENT) {
        run->complaint = "a model is missing, or the sensors have not the noise terms of the core";
        return result;
    }
    if (result == UKF_OK) {
        result = execute(run, &ukf);
    }
    if (result != UKF_OK) {
        run->fault = ukf.driver.fault;
    }
    return result;
}

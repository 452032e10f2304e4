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

/** Update with a sensor, if something of it was sampled, and add to what came of the step. */
static enum ukf_result update(struct ukf *ukf, uint32_t sensor, const ukf_real *z, uint32_t sampled,
                              struct ukf_record *record)
{
    const struct ukf_range rows = ukf_core_rows(ukf->driver.core, sensor);
    const uint32_t mask = sampled >> rows.first & (UKF_ALL >> (UKF_MAX_SIZE - rows.count));
    enum ukf_result result;

    if (mask == 0u) {
        return UKF_OK;
    }
    result = ukf_update(ukf, sensor, z + rows.first, mask);
    if (result == UKF_OK) {
        record->nis = (ukf_is_number(record->nis) ? record->nis : 0.0) + (double)ukf->nis;
        record->gated = record->gated != 0u || ukf->gated;
    }
    return result;
}

/** One step: predict, update with each sensor, and read the estimate. */
static enum ukf_result iterate(struct ukf *ukf, const struct ukf_scenario *scenario, uint32_t k,
                               ukf_real *x, struct ukf_record *record)
{
    ukf_real u[UKF_MAX_SIZE];
    ukf_real z[UKF_M];
    enum ukf_result result;

    convert(scenario->input + (size_t)k * scenario->inputs, scenario->inputs, u);
    convert(scenario->measurement + (size_t)k * scenario->m, scenario->m, z);
    result = ukf_predict(ukf, u);
    for (uint32_t i = 0; result == UKF_OK && i < ukf_core_sensors(ukf->driver.core); i++) {
        result = update(ukf, i, z, scenario->sampled[k], record);
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
    static ukf_real work[UKF_WORK_LENGTH(UKF_N, UKF_M, UKF_Q, UKF_R, UKF_POINTS)];
    const struct ukf_scenario *scenario = run->scenario;
    const struct ukf_options options = {
        .timeout_us = run->timeout_us, .redraw = scenario->redraw};
    const struct ukf_models *models;
    struct ukf ukf;
    enum ukf_result result;

    run->errors = 0;
    run->recoveries = 0;
    run->fault = (struct ukf_fault){0};
    run->complaint = NULL;
    if (scenario->n != UKF_N || scenario->m != UKF_M || scenario->q != UKF_Q ||
        scenario->r != UKF_R || scenario->inputs > UKF_MAX_SIZE) {
        run->complaint = "the scenario is not for a core of these sizes";
        return UKF_BAD_ARGUMENT;
    }
    models = ukf_application(scenario);
    if (models == NULL) {
        run->complaint = "the models are not for these sizes: ukf_application() gives none";
        return UKF_BAD_ARGUMENT;
    }
    result = ukf_open(&ukf, &core, run->port, models, &options, work,
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

#include "nanosat.h"

#include <math.h>
#include <stddef.h>

#include "ukf_core.h"

_Static_assert(UKF_N == NANOSAT_STATES, "the core must be generated for 7 states");
_Static_assert(UKF_M == NANOSAT_OBSERVATIONS, "the core must be generated for 6 observations");
_Static_assert(UKF_Q == NANOSAT_STATES, "the core must be generated for 7 process noise terms");
_Static_assert(UKF_R == NANOSAT_OBSERVATIONS, "the core must have 6 observation noise terms");
_Static_assert(UKF_SENSORS == 1u || UKF_SENSORS == 9u, "the core must have sensors of 6 or 3 + 3");

/** Observations of the accelerometer; the others are the magnetometer's. */
#define HALF (NANOSAT_OBSERVATIONS / 2u)

bool nanosat_process(void *context, const ukf_real *x, const ukf_real *w, const void *input,
                     ukf_real *next)
{
    const struct nanosat *nanosat = context;
    const ukf_real *u = input;
    const ukf_real dt = nanosat->dt;
    const ukf_real half = dt / 2;
    const ukf_real q1 = x[0], q2 = x[1], q3 = x[2], q0 = x[3];
    const ukf_real r1 = u[0] - x[4], r2 = u[1] - x[5], r3 = u[2] - x[6];

    for (uint32_t i = 0; i < NANOSAT_STATES; i++) {
        next[i] = x[i] + dt * w[i];
    }
    next[0] += half * (q0 * r1 + q2 * r3 - q3 * r2);
    next[1] += half * (q0 * r2 + q3 * r1 - q1 * r3);
    next[2] += half * (q0 * r3 + q1 * r2 - q2 * r1);
    next[3] -= half * (q1 * r1 + q2 * r2 + q3 * r3);
    return true;
}

bool nanosat_observe_gravity(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z)
{
    const ukf_real q1 = x[0], q2 = x[1], q3 = x[2], q0 = x[3];
    const ukf_real s1 = q1 * q1, s2 = q2 * q2, s3 = q3 * q3, s0 = q0 * q0;

    (void)context;
    z[0] = v[0] + 2 * (q0 * q2 + q1 * q3);
    z[1] = v[1] + 2 * (q2 * q3 - q0 * q1);
    z[2] = v[2] + (s0 - s1 - s2 + s3);
    return true;
}

bool nanosat_observe_field(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z)
{
    const ukf_real q1 = x[0], q2 = x[1], q3 = x[2], q0 = x[3];
    const ukf_real s1 = q1 * q1, s2 = q2 * q2, s3 = q3 * q3, s0 = q0 * q0;

    (void)context;
    z[0] = v[0] + (s0 + s1 - s2 - s3);
    z[1] = v[1] + 2 * (q1 * q2 + q0 * q3);
    z[2] = v[2] + 2 * (q1 * q3 - q0 * q2);
    return true;
}

bool nanosat_observe(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z)
{
    return nanosat_observe_gravity(context, x, v, z) &&
           nanosat_observe_field(context, x, v + HALF, z + HALF);
}

static const struct ukf_sensor both = {.observe = nanosat_observe, .terms = NANOSAT_OBSERVATIONS};
static const struct ukf_sensor each[] = {
    {.observe = nanosat_observe_gravity, .terms = HALF},
    {.observe = nanosat_observe_field, .terms = HALF},
};

/** Numbers of a scenario in the type of the filter. */
static void convert(const double *from, uint32_t count, ukf_real *to)
{
    for (uint32_t i = 0; i < count; i++) {
        to[i] = (ukf_real)from[i];
    }
}

static enum ukf_result start(struct ukf *ukf, const struct ukf_scenario *scenario)
{
    ukf_real x[NANOSAT_STATES];
    ukf_real P[NANOSAT_STATES * NANOSAT_STATES];
    ukf_real Q[NANOSAT_STATES * NANOSAT_STATES];
    ukf_real R[NANOSAT_OBSERVATIONS * NANOSAT_OBSERVATIONS];

    convert(scenario->x0, NANOSAT_STATES, x);
    convert(scenario->P0, NANOSAT_STATES * NANOSAT_STATES, P);
    convert(scenario->Q, NANOSAT_STATES * NANOSAT_STATES, Q);
    convert(scenario->R, NANOSAT_OBSERVATIONS * NANOSAT_OBSERVATIONS, R);
    return ukf_start(ukf, x, P, Q, R);
}

/** Update with a sensor, if something of it was sampled, and add to what came of the step. */
static enum ukf_result update(struct ukf *ukf, uint32_t sensor, const ukf_real *z, uint32_t sampled,
                              struct ukf_record *record)
{
    const struct ukf_range rows = ukf_core_rows(ukf->driver.core, sensor);
    const uint32_t mask = sampled >> rows.first & ((UINT32_C(1) << rows.count) - 1u);
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
    ukf_real u[NANOSAT_INPUTS];
    ukf_real z[NANOSAT_OBSERVATIONS];
    enum ukf_result result;

    convert(&scenario->input[k * NANOSAT_INPUTS], NANOSAT_INPUTS, u);
    convert(&scenario->measurement[k * NANOSAT_OBSERVATIONS], NANOSAT_OBSERVATIONS, z);
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

enum ukf_result nanosat_execute(struct nanosat_run *run)
{
    static ukf_real work[UKF_WORK_LENGTH(UKF_N, UKF_M, UKF_Q, UKF_R, UKF_POINTS)];
    const struct ukf_scenario *scenario = run->scenario;
    struct nanosat nanosat = {.dt = (ukf_real)scenario->interval};
    const struct ukf_models models = {
        .context = &nanosat,
        .process = nanosat_process,
        .sensors = UKF_SENSORS == 1u ? &both : each,
    };
    const struct ukf_options options = {
        .timeout_us = run->timeout_us, .redraw = scenario->redraw};
    struct ukf ukf;
    ukf_real x[NANOSAT_STATES];
    enum ukf_result result;

    run->errors = 0;
    run->recoveries = 0;
    run->fault = (struct ukf_fault){0};
    if (scenario->n != NANOSAT_STATES || scenario->m != NANOSAT_OBSERVATIONS ||
        scenario->q != NANOSAT_STATES || scenario->r != NANOSAT_OBSERVATIONS ||
        scenario->inputs != NANOSAT_INPUTS) {
        return UKF_BAD_ARGUMENT;
    }
    result = ukf_open(&ukf, run->core, run->port, &models, &options, work,
                      (uint32_t)(sizeof work / sizeof work[0]));
    if (result == UKF_OK) {
        result = start(&ukf, scenario);
    }
    if (result == UKF_OK) {
        result = ukf_state(&ukf, x);
    }
    for (uint32_t k = 0; result == UKF_OK && k < scenario->steps; k++) {
        struct ukf_record record = {.nis = NAN};

        record.result = iterate(&ukf, scenario, k, x, &record);
        if (record.result != UKF_OK) {
            record.nis = NAN;
            record.gated = 0u;
            run->errors++;
            run->fault = ukf.driver.fault;
            if (ukf.driver.doubtful) {
                result = recover(&ukf, scenario);
                run->recoveries += result == UKF_OK;
            }
            if (result == UKF_OK) {
                result = ukf_state(&ukf, x);
            }
        }
        if (result == UKF_OK && run->covariances) {
            result = ukf_covariance(&ukf, run->P);
        }
        if (run->on_step != NULL) {
            run->on_step(run->context, k, x, run->covariances ? run->P : NULL, &record);
        }
    }
    if (result == UKF_OK) {
        result = ukf_covariance(&ukf, run->P);
    }
    if (result != UKF_OK) {
        run->fault = ukf.driver.fault;
    }
    return result;
}

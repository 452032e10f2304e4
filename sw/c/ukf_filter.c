#include "ukf_filter.h"

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "ukf_factor.h"
#include "ukf_internal.h"
#include "ukf_registers.h"

/** Elements (i, j) and (j, i) of a covariance must agree to this part of sqrt(a_ii a_jj), or better. */
#define ASYMMETRY 1e-9

/** Numbers of the factors of Q and R, as the core has them. */
static uint32_t noise_length(const struct ukf_core *core)
{
    return core->q * core->q + core->r * ukf_core_noise_columns(core);
}

struct ukf_range ukf_terms_of(const struct ukf_core *core, const struct ukf_models *models,
                              uint32_t sensor)
{
    struct ukf_range terms = {.first = 0u, .count = 0u};

    if (core->r == 0u) {
        return terms;
    }
    if (core->additive_r != 0u) {
        return ukf_core_rows(core, sensor);
    }
    for (uint32_t i = 0; i < sensor; i++) {
        terms.first += models->sensors[i].terms;
    }
    terms.count = models->sensors[sensor].terms;
    return terms;
}

/** Whether all models are there or on the core, and the sensors have its noise terms. */
static bool are_complete(const struct ukf_core *core, const struct ukf_models *models)
{
    uint32_t terms = 0;

    if (models == NULL || models->sensors == NULL ||
        (models->process == NULL && core->has_f == 0u)) {
        return false;
    }
    for (uint32_t sensor = 0; sensor < ukf_core_sensors(core); sensor++) {
        const uint32_t own = models->sensors[sensor].terms;

        if ((models->sensors[sensor].observe == NULL && core->has_h == 0u) || own > UKF_MAX_SIZE) {
            return false;
        }
        terms += own;
    }
    return core->additive_r != 0u || terms == core->r;
}

/** Numbers of the largest matrix that a covariance is factorised in. */
static uint32_t scratch_length(const struct ukf_core *core)
{
    const uint32_t size = UKF_LARGER(UKF_LARGER(core->n, core->q), core->r);

    return size * size;
}

/** Have all inputs be written again. */
static void forget_inputs(const struct ukf *ukf)
{
    for (uint32_t i = 0; i < ukf->driver.core->input_count; i++) {
        ukf->inputs.held[i] = UKF_NOT_HELD;
    }
}

enum ukf_result ukf_open(struct ukf *ukf, const struct ukf_core *core, const struct ukf_port *port,
                         const struct ukf_models *models, const struct ukf_options *options,
                         ukf_real *work, uint32_t length)
{
    enum ukf_result result;

    *ukf = (struct ukf){
        .models = models,
        .redraw = options != NULL && options->redraw,
        .nis = (ukf_real)NAN,
        .gate = (ukf_real)INFINITY,
    };
    if (core == NULL || !are_complete(core, models) || options == NULL || work == NULL ||
        length < UKF_WORK_LENGTH(core->n, core->m, core->q, core->r, core->points,
                                 core->input_count)) {
        return UKF_BAD_ARGUMENT;
    }
    result = ukf_driver_open(&ukf->driver, core, port, options->timeout_us);
    if (result != UKF_OK) {
        return result;
    }
    ukf->X = work;
    ukf->Z = ukf->X + core->n * core->points;
    ukf->W = ukf->Z + core->m * core->points;
    ukf->V = ukf->W + core->q * core->points;
    ukf->x = ukf->V + core->r * core->points;
    ukf->L = ukf->x + core->n;
    ukf->next_noise = ukf->L + core->n * core->n;
    ukf->noise = ukf->next_noise + noise_length(core);
    ukf->scratch = ukf->noise + noise_length(core);
    ukf->inputs.wanted = ukf->scratch + scratch_length(core);
    ukf->inputs.held = ukf->inputs.wanted + core->input_count;
    for (uint32_t i = 0; i < core->input_count; i++) {
        ukf->inputs.wanted[i] = (ukf_real)NAN;
    }
    forget_inputs(ukf);
    return UKF_OK;
}

/* Arguments. */

/** Whether the filter is in use and in no doubt. */
static enum ukf_result ready(const struct ukf *ukf)
{
    const enum ukf_result result = ukf_driver_check(&ukf->driver);

    return result == UKF_OK && !ukf->started ? UKF_NOT_STARTED : result;
}

static bool all_finite(const ukf_real *values, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        if (!ukf_is_finite((double)values[i])) {
            return false;
        }
    }
    return true;
}

/** Whether numbers are finite in the format of the core as well. */
static bool all_fit(const struct ukf *ukf, const ukf_real *values, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        if (!ukf_is_finite((double)ukf_driver_round(&ukf->driver, values[i]))) {
            return false;
        }
    }
    return true;
}

/** Factor of a covariance; UKF_BAD_ARGUMENT if it is none, or too large for the format. */
static enum ukf_result factor(const struct ukf *ukf, uint32_t size, const ukf_real *A,
                              bool definite, ukf_real *B)
{
    const double part = fmax(ASYMMETRY, ukf_rounding_errors(size));

    if (size == 0u) {
        return UKF_OK;
    }
    if (A == NULL || !all_finite(A, size * size)) {
        return UKF_BAD_ARGUMENT;
    }
    for (uint32_t i = 0; i < size; i++) {
        for (uint32_t j = 0; j < i; j++) {
            const double limit = part * sqrt(fabs((double)A[i * size + i])) *
                                 sqrt(fabs((double)A[j * size + j]));

            if (fabs((double)A[i * size + j] - (double)A[j * size + i]) > limit) {
                return UKF_BAD_ARGUMENT;
            }
        }
    }
    if (definite && !ukf_is_definite(size, A, B)) {
        return UKF_BAD_ARGUMENT;
    }
    return ukf_lower_factor(size, A, B) && all_fit(ukf, B, size * size) ? UKF_OK : UKF_BAD_ARGUMENT;
}

static enum ukf_result factor_P(const struct ukf *ukf, const ukf_real *P, ukf_real *B)
{
    return factor(ukf, ukf->driver.core->n, P, ukf->driver.core->covariance_form != 0u, B);
}

/** Sensor that a noise term belongs to. */
static uint32_t sensor_of(const struct ukf *ukf, uint32_t term)
{
    uint32_t sensor = 0;

    for (uint32_t past = 0; sensor + 1u < ukf_core_sensors(ukf->driver.core); sensor++) {
        past += ukf_terms_of(ukf->driver.core, ukf->models, sensor).count;
        if (term < past) {
            break;
        }
    }
    return sensor;
}

/** Factor of R, r by r; UKF_BAD_ARGUMENT also if it is not zero between sensors. */
static enum ukf_result factor_R(const struct ukf *ukf, const ukf_real *R, ukf_real *B)
{
    const uint32_t r = ukf->driver.core->r;
    const enum ukf_result result = factor(ukf, r, R, false, B);

    for (uint32_t i = 0; result == UKF_OK && i < r; i++) {
        for (uint32_t j = 0; j < r; j++) {
            if (R[i * r + j] != 0 && sensor_of(ukf, i) != sensor_of(ukf, j)) {
                return UKF_BAD_ARGUMENT;
            }
        }
    }
    return result;
}

/** The factor of R within next_noise. */
static ukf_real *next_R(const struct ukf *ukf)
{
    return ukf->next_noise + ukf->driver.core->q * ukf->driver.core->q;
}

/**
 * Put the factor of a sensor's R into next_noise, beside zeros: where its noise terms are; or from
 * column 0 on if they are additive, as the core has it then.
 */
static void place_factor(const struct ukf *ukf, struct ukf_range terms, const ukf_real *B,
                         uint32_t stride)
{
    const struct ukf_core *core = ukf->driver.core;
    const uint32_t columns = ukf_core_noise_columns(core);
    const uint32_t left = core->additive_r != 0u ? 0u : terms.first;

    for (uint32_t i = 0; i < terms.count; i++) {
        ukf_real *row = next_R(ukf) + (terms.first + i) * columns;

        for (uint32_t j = 0; j < columns; j++) {
            row[j] = 0;
        }
        memcpy(row + left, B + i * stride, terms.count * sizeof *B);
    }
}

/** Factors of Q and R into next_noise. */
static enum ukf_result factor_noise(const struct ukf *ukf, const ukf_real *Q, const ukf_real *R)
{
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result = factor(ukf, core->q, Q, false, ukf->next_noise);

    if (result == UKF_OK) {
        result = factor_R(ukf, R, ukf->scratch);
    }
    for (uint32_t sensor = 0; result == UKF_OK && sensor < ukf_core_sensors(core); sensor++) {
        const struct ukf_range terms = ukf_terms_of(core, ukf->models, sensor);

        place_factor(ukf, terms, ukf->scratch + terms.first * (core->r + 1u), core->r);
    }
    return result;
}

/* Noise. */

/** Read the sigma points of a noise; zeros if it has none. */
static enum ukf_result fetch_noise(struct ukf *ukf, uint32_t base, uint32_t terms, ukf_real *points)
{
    const struct ukf_core *core = ukf->driver.core;
    const uint32_t first = ukf_core_first_point(core);
    const uint32_t count = core->points;

    if (base != 0u) {
        return ukf_driver_read(&ukf->driver, base + first * core->element_bytes, terms,
                               count - first, count, points + first);
    }
    for (uint32_t i = 0; i < terms * count; i++) {
        points[i] = 0;
    }
    return UKF_OK;
}

/** Read those that models in software need. */
static enum ukf_result fetch_noises(struct ukf *ukf)
{
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result;

    if (core->has_f != 0u && core->has_h != 0u) {
        return UKF_OK;
    }
    result = fetch_noise(ukf, core->process_noise_points, core->q, ukf->W);

    return result == UKF_OK ? fetch_noise(ukf, core->observation_noise_points, core->r, ukf->V)
                            : result;
}

/** Write factors of Q and R; of those that are there, `before`, only the rows that differ. */
static enum ukf_result write_noises(struct ukf *ukf, const ukf_real *factors,
                                    const ukf_real *before)
{
    const struct ukf_core *core = ukf->driver.core;
    const uint32_t offset = core->q * core->q;
    enum ukf_result result;

    ukf->noise_written = false;
    result = ukf_driver_rewrite(&ukf->driver, core->process_noise_factor, core->q, core->q, factors,
                                before);
    return result == UKF_OK
               ? ukf_driver_rewrite(&ukf->driver, core->observation_noise_factor, core->r,
                                    ukf_core_noise_columns(core), factors + offset,
                                    before != NULL ? before + offset : NULL)
               : result;
}

/** Write next_noise, and run INIT. */
static enum ukf_result write_next_noise(struct ukf *ukf)
{
    const enum ukf_result result =
        write_noises(ukf, ukf->next_noise, ukf->noise_written ? ukf->noise : NULL);

    return result == UKF_OK ? ukf_driver_initialise(&ukf->driver) : result;
}

/** Take next_noise, which is in the core, into use. */
static enum ukf_result use_next_noise(struct ukf *ukf)
{
    enum ukf_result result;

    memcpy(ukf->noise, ukf->next_noise, noise_length(ukf->driver.core) * sizeof *ukf->noise);
    ukf->noise_written = true;
    result = fetch_noises(ukf);
    ukf->driver.doubtful = result != UKF_OK;
    return result;
}

/** Write the factors in use, and run INIT. */
static enum ukf_result write_old_noise(struct ukf *ukf)
{
    const enum ukf_result result = write_noises(ukf, ukf->noise, NULL);

    ukf->noise_written = result == UKF_OK;
    return result == UKF_OK ? ukf_driver_initialise(&ukf->driver) : result;
}

/** If the core has refused something, go back; the refusal is the result, unless that fails. */
static enum ukf_result back_out(struct ukf *ukf, enum ukf_result result,
                                enum ukf_result (*go_back)(struct ukf *ukf))
{
    const struct ukf_fault fault = ukf->driver.fault;

    if (result != UKF_OK && !ukf->driver.doubtful) {
        const enum ukf_result back = go_back(ukf);

        if (back != UKF_OK) {
            return back;
        }
        ukf->driver.fault = fault;
    }
    return result;
}

/* Sending what is assigned. */

static enum ukf_result send_state(struct ukf *ukf)
{
    const uint32_t n = ukf->driver.core->n;

    ukf->transformed = false;
    return ukf_driver_write(&ukf->driver, ukf->driver.core->state, 1u, n, n, ukf->x);
}

static enum ukf_result send_factor(struct ukf *ukf)
{
    const uint32_t n = ukf->driver.core->n;

    ukf->transformed = false;
    return ukf_driver_write(&ukf->driver, ukf->driver.core->factor, n, n, n, ukf->L);
}

static enum ukf_result send_gate(struct ukf *ukf)
{
    return ukf_driver_gate(&ukf->driver, ukf->gate);
}

/** Sigma points of the estimate; those sent through f are not used any more. */
static enum ukf_result redraw(struct ukf *ukf)
{
    const enum ukf_result result = ukf_driver_generate(&ukf->driver);

    ukf->transformed = ukf->transformed && result != UKF_OK;
    return result;
}

static enum ukf_result send_noise(struct ukf *ukf)
{
    /* INIT would forget a prediction that has not been factorised. */
    enum ukf_result result = redraw(ukf);

    if (result != UKF_OK) {
        return result;
    }
    result = back_out(ukf, write_next_noise(ukf), write_old_noise);
    return result == UKF_OK ? use_next_noise(ukf) : result;
}

static enum ukf_result send_all(struct ukf *ukf)
{
    enum ukf_result result = ukf_driver_begin(&ukf->driver);

    ukf->noise_written = false; /* To begin anew is to rely on nothing. */
    forget_inputs(ukf);
    ukf->gated = false;
    ukf->nis = (ukf_real)NAN;
    if (result == UKF_OK) {
        result = send_state(ukf);
    }
    if (result == UKF_OK) {
        result = send_factor(ukf);
    }
    if (result == UKF_OK) {
        result = write_next_noise(ukf);
    }
    if (result == UKF_OK) {
        result = send_gate(ukf);
    }
    if (result == UKF_OK) {
        result = use_next_noise(ukf);
    }
    ukf->started = ukf->started || result == UKF_OK;
    return ukf->started ? back_out(ukf, result, write_old_noise) : result;
}

/** Finish what is being assigned; it is given up if the core refuses it. */
static enum ukf_result finish(struct ukf *ukf)
{
    const enum ukf_result result = ukf->unfinished != NULL ? ukf->unfinished(ukf) : UKF_OK;

    if (!ukf->driver.doubtful) {
        ukf->unfinished = NULL;
    }
    return result;
}

static enum ukf_result assign(struct ukf *ukf, enum ukf_result (*send)(struct ukf *ukf))
{
    ukf->unfinished = send;
    return finish(ukf);
}

/* Estimate. */

/** Begin anew from `x` and from what L and next_noise hold. */
static enum ukf_result begin(struct ukf *ukf, const ukf_real *x)
{
    enum ukf_result result;

    memcpy(ukf->x, x, ukf->driver.core->n * sizeof *x);
    result = assign(ukf, send_all);
    if (result != UKF_OK) {
        /* In doubt also if INIT was refused: x and L are others now. */
        ukf->unfinished = send_all;
        ukf->driver.doubtful = true;
    }
    return result;
}

enum ukf_result ukf_start(struct ukf *ukf, const ukf_real *x, const ukf_real *P, const ukf_real *Q,
                          const ukf_real *R)
{
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result;

    if (!ukf->driver.open) {
        return UKF_NOT_OPEN;
    }
    /* All is checked before what another assignment has left unfinished is overwritten. */
    if (!all_fit(ukf, x, core->n)) {
        return UKF_BAD_ARGUMENT;
    }
    result = factor(ukf, core->q, Q, false, ukf->scratch);
    if (result == UKF_OK) {
        result = factor_R(ukf, R, ukf->scratch);
    }
    if (result == UKF_OK) {
        result = factor_P(ukf, P, ukf->scratch);
    }
    if (result != UKF_OK) {
        return result;
    }
    (void)factor_P(ukf, P, ukf->L);
    (void)factor_noise(ukf, Q, R);
    return begin(ukf, x);
}

enum ukf_result ukf_state(struct ukf *ukf, ukf_real *x)
{
    const enum ukf_result result = ready(ukf);

    return result == UKF_OK ? ukf_driver_state(&ukf->driver, x) : result;
}

enum ukf_result ukf_covariance(struct ukf *ukf, ukf_real *P)
{
    const enum ukf_result result = ready(ukf);

    return result == UKF_OK ? ukf_driver_covariance(&ukf->driver, P) : result;
}

enum ukf_result ukf_set_state(struct ukf *ukf, const ukf_real *x)
{
    const enum ukf_result result = ready(ukf);

    if (result != UKF_OK) {
        return result;
    }
    if (!all_fit(ukf, x, ukf->driver.core->n)) {
        return UKF_BAD_ARGUMENT;
    }
    memcpy(ukf->x, x, ukf->driver.core->n * sizeof *x);
    return assign(ukf, send_state);
}

enum ukf_result ukf_set_covariance(struct ukf *ukf, const ukf_real *P)
{
    enum ukf_result result = ready(ukf);

    if (result == UKF_OK) {
        result = factor_P(ukf, P, ukf->L);
    }
    return result == UKF_OK ? assign(ukf, send_factor) : result;
}

enum ukf_result ukf_set_noise(struct ukf *ukf, const ukf_real *Q, const ukf_real *R)
{
    enum ukf_result result = ready(ukf);

    if (result == UKF_OK) {
        result = factor_noise(ukf, Q, R);
    }
    return result == UKF_OK ? assign(ukf, send_noise) : result;
}

enum ukf_result ukf_set_sensor_noise(struct ukf *ukf, uint32_t sensor, const ukf_real *R)
{
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result = ready(ukf);
    struct ukf_range terms;

    if (result != UKF_OK) {
        return result;
    }
    if (sensor >= ukf_core_sensors(core)) {
        return UKF_BAD_ARGUMENT;
    }
    terms = ukf_terms_of(core, ukf->models, sensor);
    result = factor(ukf, terms.count, R, false, ukf->scratch);
    if (result != UKF_OK) {
        return result;
    }
    memcpy(ukf->next_noise, ukf->noise, noise_length(core) * sizeof *ukf->noise);
    place_factor(ukf, terms, ukf->scratch, terms.count);
    return assign(ukf, send_noise);
}

enum ukf_result ukf_set_gate(struct ukf *ukf, ukf_real gate)
{
    const enum ukf_result result = ready(ukf);

    if (result != UKF_OK) {
        return result;
    }
    if (!ukf_is_number((double)gate) || gate < 0) {
        return UKF_BAD_ARGUMENT;
    }
    ukf->gate = gate;
    return assign(ukf, send_gate);
}

/* Sigma points. */

enum ukf_result ukf_redraw(struct ukf *ukf)
{
    const enum ukf_result result = ready(ukf);

    return result == UKF_OK ? redraw(ukf) : result;
}

/** Sigma points of the estimate into X. */
static enum ukf_result draw(struct ukf *ukf)
{
    const enum ukf_result result = redraw(ukf);

    return result == UKF_OK ? ukf_driver_points(&ukf->driver, ukf->X) : result;
}

static enum ukf_result undo_predict(struct ukf *ukf)
{
    const enum ukf_result result = ukf_driver_undo_predict(&ukf->driver);

    ukf->transformed = ukf->transformed && result != UKF_OK;
    return result;
}

/* Predict and update. */

/** Whether the inputs of f on the core have been set. */
static enum ukf_result check_inputs_of_f(struct ukf *ukf)
{
    for (uint32_t i = 0; i < ukf->driver.core->inputs_of_f; i++) {
        if (!ukf_is_number((double)ukf->inputs.wanted[i])) {
            ukf->driver.fault = (struct ukf_fault){.step = UKF_STEP_F, .index = i};
            return UKF_BAD_ARGUMENT;
        }
    }
    return UKF_OK;
}

enum ukf_result ukf_set_inputs(struct ukf *ukf, uint32_t first, uint32_t count,
                               const ukf_real *values)
{
    uint32_t total;

    if (!ukf->driver.open) {
        return UKF_NOT_OPEN;
    }
    total = ukf->driver.core->input_count;
    if (first > total || count > total - first || !all_fit(ukf, values, count)) {
        return UKF_BAD_ARGUMENT;
    }
    memcpy(ukf->inputs.wanted + first, values, count * sizeof *values);
    return UKF_OK;
}

/** End a predict with new sigma points; without them it has not been done. */
static enum ukf_result finish_predict(struct ukf *ukf)
{
    return ukf->redraw ? back_out(ukf, redraw(ukf), undo_predict) : UKF_OK;
}

static enum ukf_result predict_on_core(struct ukf *ukf)
{
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result = check_inputs_of_f(ukf);

    if (result != UKF_OK) {
        return result;
    }
    result = ukf_driver_f(&ukf->driver, &ukf->inputs);
    /* Points of a prediction before it may be there still if it broke off when drawing new ones. */
    ukf->transformed = ukf->transformed && ukf->driver.doubtful &&
                       ukf->driver.step == UKF_STEP_SIG_GEN;
    if (result == UKF_OK) {
        result = finish_predict(ukf);
    }
    if (result == UKF_OK && !ukf->redraw && core->has_h == 0u) {
        result = ukf_driver_propagated(&ukf->driver, ukf->X);
        ukf->transformed = result == UKF_OK;
    }
    return result;
}

enum ukf_result ukf_predict(struct ukf *ukf, const void *input)
{
    enum ukf_result result = ready(ukf);

    if (result != UKF_OK) {
        return result;
    }
    if (ukf->models->on_predict != NULL) {
        ukf->models->on_predict(ukf->models->context, input);
    }
    if (ukf->driver.core->has_f != 0u) {
        return predict_on_core(ukf);
    }
    result = draw(ukf);
    if (result == UKF_OK) {
        result = ukf_software_f(ukf, input);
    }
    if (result != UKF_OK) {
        return result;
    }
    result = ukf_driver_predict(&ukf->driver, ukf->X);
    ukf->transformed = result == UKF_OK;
    return result == UKF_OK ? finish_predict(ukf) : result;
}

/** An observation with what of it was sampled. */
struct observation {
    ukf_real z[UKF_MAX_SIZE];
    uint32_t used; /**< Bit i: row i of the sensor was sampled. */
};

/** Check what an update is given. */
static enum ukf_result take(struct ukf *ukf, uint32_t sensor, const ukf_real *z, uint32_t mask,
                            struct observation *taken)
{
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result = ready(ukf);
    uint32_t rows;

    if (result != UKF_OK) {
        return result;
    }
    if (sensor >= ukf_core_sensors(core)) {
        return UKF_BAD_ARGUMENT;
    }
    rows = ukf_core_rows(core, sensor).count;
    taken->used = mask & (UKF_ALL >> (UKF_MAX_SIZE - rows));
    for (uint32_t i = 0; i < rows; i++) {
        const bool used = (taken->used >> i & 1u) != 0u;

        if (used && !ukf_is_finite((double)z[i])) {
            return UKF_BAD_ARGUMENT;
        }
        taken->z[i] = used ? z[i] : (ukf_real)0;
    }
    return core->has_h == 0u ||
                   ukf_driver_has(&ukf->driver, sensor, ukf->models->sensors[sensor].variant)
               ? UKF_OK
               : UKF_BAD_ARGUMENT;
}

/** It is for a gate to reject what is too large for the format, which is binary32 then. */
static void clamp(const struct ukf *ukf, uint32_t rows, ukf_real *z)
{
    for (uint32_t i = 0; i < rows && ukf_is_finite((double)ukf->gate); i++) {
        if (!all_fit(ukf, &z[i], 1u)) {
            z[i] = z[i] > 0 ? (ukf_real)FLT_MAX : -(ukf_real)FLT_MAX;
        }
    }
}

enum ukf_result ukf_update(struct ukf *ukf, uint32_t sensor, const ukf_real *z, uint32_t mask)
{
    struct ukf_driver *driver = &ukf->driver;
    struct observation taken;
    enum ukf_result result = take(ukf, sensor, z, mask, &taken);
    uint32_t rows;

    if (result != UKF_OK || taken.used == 0u) {
        return result;
    }
    rows = ukf_core_rows(driver->core, sensor).count;
    if (driver->core->has_h != 0u) {
        clamp(ukf, rows, taken.z);
        result = ukf_driver_h(driver, sensor, ukf->models->sensors[sensor].variant, &ukf->inputs,
                              taken.z, taken.used, &ukf->nis, &ukf->gated);
    } else {
        if (!ukf->transformed) {
            result = draw(ukf);
        }
        if (result == UKF_OK) {
            result = ukf_software_h(ukf, sensor, taken.used, taken.z);
        }
        if (result == UKF_OK) {
            result = ukf_software_varies(ukf, sensor, taken.used);
        }
        if (result == UKF_OK) {
            clamp(ukf, rows, taken.z);
            result = ukf_driver_update(driver, sensor, ukf->Z, taken.z, taken.used, &ukf->nis,
                                       &ukf->gated);
        }
    }
    if (result == UKF_OK && !ukf->gated) {
        ukf->transformed = false;
    }
    return result;
}

enum ukf_result ukf_iterate(struct ukf *ukf, const void *input, uint32_t sensor, const ukf_real *z,
                            uint32_t mask)
{
    const struct ukf_core *core = ukf->driver.core;
    struct observation taken;
    enum ukf_result result = take(ukf, sensor, z, mask, &taken);

    if (result != UKF_OK) {
        return result;
    }
    if (taken.used == 0u || ukf->redraw || core->has_f == 0u || core->has_h == 0u) {
        result = ukf_predict(ukf, input);
        return result == UKF_OK ? ukf_update(ukf, sensor, z, mask) : result;
    }
    result = check_inputs_of_f(ukf);
    if (result != UKF_OK) {
        return result;
    }
    clamp(ukf, ukf_core_rows(core, sensor).count, taken.z);
    ukf->transformed = false;
    return ukf_driver_iterate(&ukf->driver, sensor, ukf->models->sensors[sensor].variant,
                              &ukf->inputs, taken.z, taken.used, &ukf->nis, &ukf->gated);
}

/* Recovery. */

enum ukf_result ukf_save(struct ukf *ukf, ukf_real *x, ukf_real *L)
{
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result;

    /* After a PREDICT the covariance is residuals, and L is that from before. */
    result = ukf_redraw(ukf);
    if (result == UKF_OK) {
        result = ukf_state(ukf, x);
    }
    return result == UKF_OK ? ukf_driver_read(&ukf->driver, core->factor, core->n, core->n, core->n, L)
                            : result;
}

enum ukf_result ukf_restore(struct ukf *ukf, const ukf_real *x, const ukf_real *L)
{
    const uint32_t n = ukf->driver.open ? ukf->driver.core->n : 0u;

    if (!ukf->started) {
        return ukf->driver.open ? UKF_NOT_STARTED : UKF_NOT_OPEN;
    }
    if (!all_fit(ukf, x, n) || !all_fit(ukf, L, n * n)) {
        return UKF_BAD_ARGUMENT;
    }
    memcpy(ukf->L, L, n * n * sizeof *L);
    memcpy(ukf->next_noise, ukf->noise, noise_length(ukf->driver.core) * sizeof *ukf->noise);
    return begin(ukf, x);
}

enum ukf_result ukf_recover(struct ukf *ukf)
{
    enum ukf_result result;

    if (ukf->driver.open && !ukf->started && ukf->unfinished == NULL) {
        return UKF_NOT_STARTED;
    }
    result = ukf_driver_recover(&ukf->driver);
    if (result == UKF_OK && ukf->redraw) {
        result = ukf_driver_undo_predict(&ukf->driver);
    }
    if (result == UKF_OK && !ukf->driver.initialised) {
        /* It has been reset; before it has been started, `unfinished` sends all. */
        result = send_gate(ukf);
        if (result == UKF_OK && ukf->started) {
            result = write_old_noise(ukf);
        }
    }
    if (result != UKF_OK) {
        return result;
    }
    ukf->gated = false;
    ukf->nis = (ukf_real)NAN;
    ukf->transformed = ukf->transformed && ukf->driver.predicted;
    return finish(ukf);
}

enum ukf_result ukf_undo_predict(struct ukf *ukf)
{
    const enum ukf_result result = ready(ukf);

    if (result != UKF_OK) {
        return result;
    }
    return ukf->driver.predicted ? undo_predict(ukf) : UKF_BAD_ARGUMENT;
}

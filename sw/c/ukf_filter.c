#include "ukf_filter.h"

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "ukf_factor.h"
#include "ukf_registers.h"

#define TURN 6.283185307179586476925286766559

/** Elements (i, j) and (j, i) of a covariance must agree to this part of sqrt(a_ii a_jj), or better. */
#define ASYMMETRY 1e-9

/** Numbers of the factors of Q and R, as the core has them. */
static uint32_t noise_length(const struct ukf_core *core)
{
    return core->q * core->q + core->r * ukf_core_noise_columns(core);
}

/** Noise terms of a sensor, which are rows of V and of R. */
static struct ukf_range terms_of(const struct ukf_core *core, const struct ukf_models *models,
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

/** Whether all models are there, and the sensors have the noise terms of the core. */
static bool are_complete(const struct ukf_core *core, const struct ukf_models *models)
{
    uint32_t terms = 0;

    if (models == NULL || models->process == NULL || models->sensors == NULL) {
        return false;
    }
    for (uint32_t sensor = 0; sensor < ukf_core_sensors(core); sensor++) {
        const uint32_t own = models->sensors[sensor].terms;

        if (models->sensors[sensor].observe == NULL || own > UKF_MAX_SIZE) {
            return false;
        }
        terms += own;
    }
    return core->additive_r != 0u || terms == core->r;
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
        length < UKF_WORK_LENGTH(core->n, core->m, core->q, core->r, core->points)) {
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
        past += terms_of(ukf->driver.core, ukf->models, sensor).count;
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
        const struct ukf_range terms = terms_of(core, ukf->models, sensor);

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

static enum ukf_result fetch_noises(struct ukf *ukf)
{
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result = fetch_noise(ukf, core->process_noise_points, core->q, ukf->W);

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
    terms = terms_of(core, ukf->models, sensor);
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

/** Column k of a matrix. */
static void get_column(const ukf_real *matrix, uint32_t rows, uint32_t columns, uint32_t k,
                       ukf_real *column)
{
    for (uint32_t i = 0; i < rows; i++) {
        column[i] = matrix[i * columns + k];
    }
}

static void put_column(ukf_real *matrix, uint32_t rows, uint32_t columns, uint32_t k,
                       const ukf_real *column)
{
    for (uint32_t i = 0; i < rows; i++) {
        matrix[i * columns + k] = column[i];
    }
}

static enum ukf_result bad_model(struct ukf *ukf, uint32_t point, uint32_t row)
{
    ukf->driver.fault = (struct ukf_fault){.point = point, .index = row};
    return UKF_BAD_MODEL;
}

/** Look at the result of a model for sigma point k; rows that are not used become zero. */
static enum ukf_result check_result(struct ukf *ukf, bool success, ukf_real *values, uint32_t rows,
                                    uint32_t used, uint32_t k)
{
    if (!success) {
        return bad_model(ukf, k, 0u);
    }
    for (uint32_t i = 0; i < rows; i++) {
        if ((used >> i & 1u) == 0u) {
            values[i] = 0;
        } else if (!ukf_is_finite((double)values[i])) {
            return bad_model(ukf, k, i);
        }
    }
    return UKF_OK;
}

/** Angle shifted by whole turns to within half a turn of a reference, in radians. */
static ukf_real wrap(ukf_real angle, ukf_real reference)
{
    return (ukf_real)((double)angle - TURN * rint(((double)angle - (double)reference) / TURN));
}

/** Wrap the rows that are angles to within half a turn of the centre, which stays as it is. */
static void wrap_rows(const struct ukf_core *core, ukf_real *matrix, uint32_t rows, uint32_t angles)
{
    for (uint32_t i = 0; i < rows; i++) {
        ukf_real *row = matrix + i * core->points;
        const ukf_real centre = row[ukf_core_centre(core)];

        for (uint32_t k = ukf_core_first_point(core);
             (angles >> i & 1u) != 0u && k < core->points; k++) {
            row[k] = wrap(row[k], centre);
        }
    }
}

static enum ukf_result undo_predict(struct ukf *ukf)
{
    const enum ukf_result result = ukf_driver_undo_predict(&ukf->driver);

    ukf->transformed = ukf->transformed && result != UKF_OK;
    return result;
}

enum ukf_result ukf_predict(struct ukf *ukf, const void *input)
{
    const struct ukf_core *core = ukf->driver.core;
    const struct ukf_models *models = ukf->models;
    ukf_real x[UKF_MAX_SIZE];
    ukf_real w[UKF_MAX_SIZE];
    ukf_real next[UKF_MAX_SIZE];
    enum ukf_result result = ready(ukf);

    if (result == UKF_OK) {
        result = draw(ukf);
    }
    for (uint32_t k = ukf_core_first_point(core); result == UKF_OK && k < core->points; k++) {
        get_column(ukf->X, core->n, core->points, k, x);
        get_column(ukf->W, core->q, core->points, k, w);
        result = check_result(ukf, models->process(models->context, x, w, input, next), next,
                              core->n, UKF_ALL, k);
        put_column(ukf->X, core->n, core->points, k, next);
    }
    if (result != UKF_OK) {
        return result;
    }
    wrap_rows(core, ukf->X, core->n, models->state_angles);
    result = ukf_driver_predict(&ukf->driver, ukf->X);
    ukf->transformed = result == UKF_OK;
    return result == UKF_OK && ukf->redraw ? back_out(ukf, redraw(ukf), undo_predict) : result;
}

/** Whether all numbers are zero in the format of the core. */
static bool all_zero(const struct ukf *ukf, const ukf_real *values, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        if (ukf_driver_round(&ukf->driver, values[i]) != 0) {
            return false;
        }
    }
    return true;
}

/**
 * Refuse a row of Z that is one number for all sigma points and has no noise. Its variance is zero,
 * but the core would find the rounding error of its mean, and nothing to compare that with. Of a row
 * of zeros it finds zero, of one that overflows that it is not finite, and says so itself.
 */
static enum ukf_result check_varies(struct ukf *ukf, struct ukf_range rows, uint32_t used)
{
    const struct ukf_core *core = ukf->driver.core;
    const ukf_real *factor = ukf->noise + core->q * core->q;
    const uint32_t number = ukf_core_first_point(core);

    for (uint32_t i = 0; i < rows.count; i++) {
        const ukf_real *row = ukf->Z + i * core->points;
        const ukf_real first = ukf_driver_round(&ukf->driver, row[number]);
        bool varies = (used >> i & 1u) == 0u || first == 0 || !ukf_is_finite((double)first);

        if (core->additive_r != 0u) {
            const uint32_t columns = ukf_core_noise_columns(core);

            varies = varies || !all_zero(ukf, factor + (rows.first + i) * columns, columns);
        }
        for (uint32_t k = number + 1u; !varies && k < core->points; k++) {
            varies = ukf_driver_round(&ukf->driver, row[k]) != first;
        }
        if (!varies) {
            ukf->driver.fault = (struct ukf_fault){
                .step = UKF_STEP_UPDATE,
                .code = UKF_ERROR_CODE_SINGULAR_OBSERVATION,
                .index = rows.first + i,
            };
            return UKF_SINGULAR_OBSERVATION;
        }
    }
    return UKF_OK;
}

/** What is expected of a row of z: its value at the mean; without W0 all weights are equal. */
static ukf_real expected(const struct ukf *ukf, uint32_t row)
{
    const struct ukf_core *core = ukf->driver.core;
    const uint32_t first = ukf_core_first_point(core);
    const ukf_real *points = ukf->Z + row * core->points;
    double sum = 0;

    if (first == 0u) {
        return points[0];
    }
    for (uint32_t k = first; k < core->points; k++) {
        sum += (double)points[k];
    }
    return (ukf_real)(sum / (double)(core->points - first));
}

enum ukf_result ukf_update(struct ukf *ukf, uint32_t sensor, const ukf_real *z, uint32_t mask)
{
    const struct ukf_core *core = ukf->driver.core;
    const struct ukf_models *models = ukf->models;
    ukf_real x[UKF_MAX_SIZE];
    ukf_real v[UKF_MAX_SIZE];
    ukf_real observation[UKF_MAX_SIZE];
    enum ukf_result result = ready(ukf);
    const struct ukf_sensor *own;
    struct ukf_range terms;
    uint32_t rows;
    uint32_t used;
    uint32_t angles;

    if (result != UKF_OK) {
        return result;
    }
    if (sensor >= ukf_core_sensors(core)) {
        return UKF_BAD_ARGUMENT;
    }
    own = &models->sensors[sensor];
    terms = terms_of(core, models, sensor);
    rows = ukf_core_rows(core, sensor).count;
    used = mask & (UKF_ALL >> (UKF_MAX_SIZE - rows));
    angles = own->angles & used;
    if (used == 0u) {
        return UKF_OK;
    }
    for (uint32_t i = 0; i < rows; i++) {
        if ((used >> i & 1u) != 0u && !ukf_is_finite((double)z[i])) {
            return UKF_BAD_ARGUMENT;
        }
    }
    if (!ukf->transformed) {
        result = draw(ukf);
    }
    for (uint32_t k = ukf_core_first_point(core); result == UKF_OK && k < core->points; k++) {
        get_column(ukf->X, core->n, core->points, k, x);
        get_column(ukf->V + terms.first * core->points, terms.count, core->points, k, v);
        result = check_result(ukf, own->observe(models->context, x, v, observation), observation,
                              rows, used, k);
        put_column(ukf->Z, rows, core->points, k, observation);
    }
    if (result != UKF_OK) {
        return result;
    }
    wrap_rows(core, ukf->Z, rows, angles);
    for (uint32_t i = 0; i < rows; i++) {
        observation[i] = (used >> i & 1u) != 0u ? z[i] : (ukf_real)0;
        if ((angles >> i & 1u) != 0u) {
            observation[i] = wrap(observation[i], expected(ukf, i));
        }
        /* It is for a gate to reject what is too large for the format, which is binary32 then. */
        if (ukf_is_finite((double)ukf->gate) && !all_fit(ukf, &observation[i], 1u)) {
            observation[i] = observation[i] > 0 ? (ukf_real)FLT_MAX : -(ukf_real)FLT_MAX;
        }
    }
    result = check_varies(ukf, ukf_core_rows(core, sensor), used);
    if (result != UKF_OK) {
        return result;
    }
    result = ukf_driver_update(&ukf->driver, sensor, ukf->Z, observation, used, &ukf->nis,
                               &ukf->gated);
    if (result == UKF_OK && !ukf->gated) {
        ukf->transformed = false;
    }
    return result;
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

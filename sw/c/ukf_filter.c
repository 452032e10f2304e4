#include "ukf_filter.h"

#include <math.h>
#include <stddef.h>

#include "ukf_factor.h"

#define TURN 6.283185307179586476925286766559

/** Rows i and j of a matrix must agree to this part of its largest element. */
#define ASYMMETRY (sizeof(ukf_real) == sizeof(double) ? 1e-9 : 1e-5)

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
    if (core == NULL || models == NULL || models->process == NULL || models->observe == NULL ||
        options == NULL || work == NULL ||
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
    ukf->scratch = ukf->V + core->r * core->points;
    return UKF_OK;
}

/* Arguments. */

static bool all_finite(const ukf_real *values, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        if (!isfinite(values[i])) {
            return false;
        }
    }
    return true;
}

/** Factor of a covariance into scratch; UKF_BAD_ARGUMENT if it is none. */
static enum ukf_result factor(struct ukf *ukf, uint32_t size, const ukf_real *A, bool definite)
{
    double largest = 0.0;

    if (size == 0u) {
        return UKF_OK;
    }
    if (A == NULL || !all_finite(A, size * size)) {
        return UKF_BAD_ARGUMENT;
    }
    for (uint32_t i = 0; i < size * size; i++) {
        largest = fmax(largest, fabs((double)A[i]));
    }
    for (uint32_t i = 0; i < size; i++) {
        for (uint32_t j = 0; j < i; j++) {
            if (fabs((double)A[i * size + j] - (double)A[j * size + i]) > ASYMMETRY * largest) {
                return UKF_BAD_ARGUMENT;
            }
        }
    }
    if (!ukf_lower_factor(size, A, ukf->scratch)) {
        return UKF_BAD_ARGUMENT;
    }
    for (uint32_t i = 0; definite && i < size; i++) {
        if (!(ukf->scratch[i * size + i] > 0)) {
            return UKF_BAD_ARGUMENT;
        }
    }
    return UKF_OK;
}

/** Factor a covariance and write the factor to a region. */
static enum ukf_result send_factor(struct ukf *ukf, uint32_t base, uint32_t size, const ukf_real *A,
                                   bool definite)
{
    enum ukf_result result = factor(ukf, size, A, definite);

    return result == UKF_OK && size != 0u
               ? ukf_driver_write(&ukf->driver, base, size, size, size, ukf->scratch)
               : result;
}

static bool needs_definite(const struct ukf *ukf)
{
    return ukf->driver.core->covariance_form != 0u;
}

/* Noise. */

/** Read the sigma points of a noise; zeros if it has none. */
static enum ukf_result fetch_noise(struct ukf *ukf, uint32_t base, uint32_t terms, ukf_real *points)
{
    const uint32_t count = ukf->driver.core->points;

    if (base != 0u) {
        return ukf_driver_read(&ukf->driver, base, terms, count, count, points);
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

/** Write the factors of Q and R, both of which have been checked. */
static enum ukf_result send_noises(struct ukf *ukf, const ukf_real *Q, const ukf_real *R)
{
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result = send_factor(ukf, core->process_noise_factor, core->q, Q, false);

    return result == UKF_OK ? send_factor(ukf, core->observation_noise_factor, core->r, R, false)
                            : result;
}

static enum ukf_result check_noises(struct ukf *ukf, const ukf_real *Q, const ukf_real *R)
{
    const enum ukf_result result = factor(ukf, ukf->driver.core->q, Q, false);

    return result == UKF_OK ? factor(ukf, ukf->driver.core->r, R, false) : result;
}

/* Estimate. */

enum ukf_result ukf_start(struct ukf *ukf, const ukf_real *x, const ukf_real *P, const ukf_real *Q,
                          const ukf_real *R)
{
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result;

    if (!all_finite(x, core->n)) {
        return UKF_BAD_ARGUMENT;
    }
    result = factor(ukf, core->n, P, needs_definite(ukf));
    if (result == UKF_OK) {
        result = check_noises(ukf, Q, R);
    }
    if (result != UKF_OK) {
        return result;
    }
    ukf->transformed = false;
    ukf->gated = false;
    ukf->nis = (ukf_real)NAN;
    result = ukf_driver_reset(&ukf->driver);
    if (result == UKF_OK) {
        result = ukf_driver_write(&ukf->driver, core->state, 1u, core->n, core->n, x);
    }
    if (result == UKF_OK) {
        result = send_factor(ukf, core->factor, core->n, P, needs_definite(ukf));
    }
    if (result == UKF_OK) {
        result = send_noises(ukf, Q, R);
    }
    if (result == UKF_OK) {
        result = ukf_driver_initialise(&ukf->driver);
    }
    if (result == UKF_OK) {
        result = ukf_driver_gate(&ukf->driver, ukf->gate);
    }
    return result == UKF_OK ? fetch_noises(ukf) : result;
}

enum ukf_result ukf_state(struct ukf *ukf, ukf_real *x)
{
    const struct ukf_core *core = ukf->driver.core;

    return ukf_driver_read(&ukf->driver, core->state, 1u, core->n, core->n, x);
}

enum ukf_result ukf_covariance(struct ukf *ukf, ukf_real *P)
{
    return ukf_driver_covariance(&ukf->driver, P);
}

enum ukf_result ukf_set_state(struct ukf *ukf, const ukf_real *x)
{
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result;

    if (!all_finite(x, core->n)) {
        return UKF_BAD_ARGUMENT;
    }
    ukf->transformed = false;
    result = ukf_driver_write(&ukf->driver, core->state, 1u, core->n, core->n, x);
    if (result == UKF_OK) {
        ukf_driver_note_write(&ukf->driver);
    }
    return result;
}

enum ukf_result ukf_set_covariance(struct ukf *ukf, const ukf_real *P)
{
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result = factor(ukf, core->n, P, needs_definite(ukf));

    if (result != UKF_OK) {
        return result;
    }
    ukf->transformed = false;
    result = ukf_driver_write(&ukf->driver, core->factor, core->n, core->n, core->n, ukf->scratch);
    if (result == UKF_OK) {
        ukf_driver_note_write(&ukf->driver);
    }
    return result;
}

enum ukf_result ukf_set_noise(struct ukf *ukf, const ukf_real *Q, const ukf_real *R)
{
    enum ukf_result result = check_noises(ukf, Q, R);

    if (result != UKF_OK) {
        return result;
    }
    ukf->transformed = false;
    /* INIT would forget a prediction that has not been factorised. */
    result = ukf_driver_generate(&ukf->driver);
    if (result == UKF_OK) {
        result = send_noises(ukf, Q, R);
    }
    if (result == UKF_OK) {
        ukf->driver.initialised = false;
        result = ukf_driver_initialise(&ukf->driver);
    }
    return result == UKF_OK ? fetch_noises(ukf) : result;
}

enum ukf_result ukf_set_gate(struct ukf *ukf, ukf_real gate)
{
    enum ukf_result result;

    if (!(gate >= 0)) {
        return UKF_BAD_ARGUMENT;
    }
    result = ukf_driver_gate(&ukf->driver, gate);
    if (result == UKF_OK) {
        ukf->gate = gate;
    }
    return result;
}

/* Sigma points. */

/** Whether a step that ended so has changed nothing. After other errors that is not certain. */
static bool is_verdict(enum ukf_result result)
{
    return result == UKF_NOT_FINITE || result == UKF_SINGULAR_OBSERVATION ||
           result == UKF_NOT_POSITIVE_DEFINITE;
}

/** After an error that is no verdict, points sent through f are not those of the core any more. */
static enum ukf_result judged(struct ukf *ukf, enum ukf_result result)
{
    if (result != UKF_OK && !is_verdict(result)) {
        ukf->transformed = false;
    }
    return result;
}

enum ukf_result ukf_redraw(struct ukf *ukf)
{
    const enum ukf_result result = judged(ukf, ukf_driver_generate(&ukf->driver));

    if (result == UKF_OK) {
        ukf->transformed = false;
    }
    return result;
}

/** Sigma points of the estimate into X. Columns n + 2 and up are copies of x, which is column 0. */
static enum ukf_result draw(struct ukf *ukf)
{
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result = ukf_redraw(ukf);

    if (result != UKF_OK) {
        return result;
    }
    result = ukf_driver_read(&ukf->driver, core->state_points, core->n, core->n + 2u, core->points,
                             ukf->X);
    for (uint32_t i = 0; i < core->n; i++) {
        ukf_real *row = ukf->X + i * core->points;

        for (uint32_t k = core->n + 2u; k < core->points; k++) {
            row[k] = row[0];
        }
    }
    return result;
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
        } else if (!isfinite(values[i])) {
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

/** Wrap the rows that are angles to within half a turn of sigma point 0. */
static void wrap_rows(ukf_real *matrix, uint32_t rows, uint32_t columns, uint32_t angles)
{
    for (uint32_t i = 0; i < rows; i++) {
        for (uint32_t k = 0; (angles >> i & 1u) != 0u && k < columns; k++) {
            matrix[i * columns + k] = wrap(matrix[i * columns + k], matrix[i * columns]);
        }
    }
}

enum ukf_result ukf_predict(struct ukf *ukf, const void *input)
{
    const struct ukf_core *core = ukf->driver.core;
    const struct ukf_models *models = ukf->models;
    ukf_real x[UKF_MAX_SIZE];
    ukf_real w[UKF_MAX_SIZE];
    ukf_real next[UKF_MAX_SIZE];
    enum ukf_result result = draw(ukf);

    for (uint32_t k = 0; result == UKF_OK && k < core->points; k++) {
        get_column(ukf->X, core->n, core->points, k, x);
        get_column(ukf->W, core->q, core->points, k, w);
        result = check_result(ukf, models->process(models->context, x, w, input, next), next,
                              core->n, UKF_ALL, k);
        put_column(ukf->X, core->n, core->points, k, next);
    }
    if (result != UKF_OK) {
        return result;
    }
    wrap_rows(ukf->X, core->n, core->points, models->state_angles);
    result = judged(ukf, ukf_driver_predict(&ukf->driver, ukf->X));
    if (result != UKF_OK) {
        return result;
    }
    ukf->transformed = true;
    return ukf->redraw ? ukf_redraw(ukf) : UKF_OK;
}

enum ukf_result ukf_update(struct ukf *ukf, const ukf_real *z, uint32_t mask)
{
    const struct ukf_core *core = ukf->driver.core;
    const struct ukf_models *models = ukf->models;
    const uint32_t used = mask & (UKF_ALL >> (UKF_MAX_SIZE - core->m));
    ukf_real x[UKF_MAX_SIZE];
    ukf_real v[UKF_MAX_SIZE];
    ukf_real observation[UKF_MAX_SIZE];
    enum ukf_result result = UKF_OK;

    if (used == 0u) {
        return UKF_OK;
    }
    for (uint32_t i = 0; i < core->m; i++) {
        if ((used >> i & 1u) != 0u && !isfinite(z[i])) {
            return UKF_BAD_ARGUMENT;
        }
    }
    if (!ukf->transformed) {
        result = draw(ukf);
    }
    for (uint32_t k = 0; result == UKF_OK && k < core->points; k++) {
        get_column(ukf->X, core->n, core->points, k, x);
        get_column(ukf->V, core->r, core->points, k, v);
        result = check_result(ukf, models->observe(models->context, x, v, observation),
                              observation, core->m, used, k);
        put_column(ukf->Z, core->m, core->points, k, observation);
    }
    if (result != UKF_OK) {
        return result;
    }
    wrap_rows(ukf->Z, core->m, core->points, models->observation_angles & used);
    for (uint32_t i = 0; i < core->m; i++) {
        observation[i] = (used >> i & 1u) != 0u ? z[i] : (ukf_real)0;
        if ((models->observation_angles & used) >> i & 1u) {
            observation[i] = wrap(observation[i], ukf->Z[i * core->points]);
        }
    }
    result = judged(ukf, ukf_driver_update(&ukf->driver, ukf->Z, observation, used, &ukf->nis,
                                           &ukf->gated));
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
    const struct ukf_core *core = ukf->driver.core;
    enum ukf_result result;

    ukf->transformed = false;
    result = ukf_driver_reset(&ukf->driver);
    if (result == UKF_OK) {
        result = ukf_driver_write(&ukf->driver, core->state, 1u, core->n, core->n, x);
    }
    if (result == UKF_OK) {
        result = ukf_driver_write(&ukf->driver, core->factor, core->n, core->n, core->n, L);
    }
    return result == UKF_OK ? ukf_driver_initialise(&ukf->driver) : result;
}

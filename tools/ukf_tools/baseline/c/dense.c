/* The filter as the papers describe it, with the GNU Scientific Library.
 *
 * All noise is augmented, so every iteration factors a covariance of 20 by 20 and multiplies it
 * with 20 by 22 sigma coefficients, dense. Equation numbers are those of Soh and Wu 2018.
 */
#include "baseline.h"

#include <gsl/gsl_blas.h>
#include <gsl/gsl_errno.h>
#include <gsl/gsl_linalg.h>
#include <gsl/gsl_matrix.h>
#include <math.h>

enum { M = 2 * STATES + OBSERVATIONS, N = M + 2 };

static double dt;
static gsl_vector *x, *weights, *z_mean, *innovation;
static gsl_matrix *P, *Q, *R, *sigma, *augmented, *points, *transformed, *observed;
static gsl_matrix *x_residuals, *z_residuals, *weighted, *S, *S_inverse, *cross, *K, *KS;

/* Sigma coefficients of the spherical simplex, W0 = 0 (equations 5 to 7). */
static void make_sigma(void)
{
    const double W1 = 1.0 / (M + 1);
    gsl_vector_set_all(weights, W1);
    gsl_vector_set(weights, 0, 0.0);
    gsl_matrix_set_zero(sigma);
    for (int j = 1; j <= M; j++) {
        const double a = 1.0 / sqrt(j * (j + 1) * W1);
        for (int k = 1; k <= j; k++)
            gsl_matrix_set(sigma, j - 1, k, -a);
        gsl_matrix_set(sigma, j - 1, j + 1, j * a);
    }
}

static void initialise(double interval, const double *x0, const double *P0, const double *Q0,
                       const double *R0)
{
    gsl_set_error_handler_off();
    dt = interval;
    x = gsl_vector_alloc(STATES);
    weights = gsl_vector_alloc(N);
    z_mean = gsl_vector_alloc(OBSERVATIONS);
    innovation = gsl_vector_alloc(OBSERVATIONS);
    P = gsl_matrix_alloc(STATES, STATES);
    Q = gsl_matrix_alloc(STATES, STATES);
    R = gsl_matrix_alloc(OBSERVATIONS, OBSERVATIONS);
    sigma = gsl_matrix_alloc(M, N);
    augmented = gsl_matrix_alloc(M, M);
    points = gsl_matrix_alloc(M, N);
    transformed = gsl_matrix_alloc(STATES, N);
    observed = gsl_matrix_alloc(OBSERVATIONS, N);
    x_residuals = gsl_matrix_alloc(STATES, N);
    z_residuals = gsl_matrix_alloc(OBSERVATIONS, N);
    weighted = gsl_matrix_alloc(OBSERVATIONS, N);
    S = gsl_matrix_alloc(OBSERVATIONS, OBSERVATIONS);
    S_inverse = gsl_matrix_alloc(OBSERVATIONS, OBSERVATIONS);
    cross = gsl_matrix_alloc(STATES, OBSERVATIONS);
    K = gsl_matrix_alloc(STATES, OBSERVATIONS);
    KS = gsl_matrix_alloc(STATES, OBSERVATIONS);
    for (int i = 0; i < STATES; i++)
        gsl_vector_set(x, i, x0[i]);
    for (int i = 0; i < STATES * STATES; i++) {
        P->data[i] = P0[i];
        Q->data[i] = Q0[i];
    }
    for (int i = 0; i < OBSERVATIONS * OBSERVATIONS; i++)
        R->data[i] = R0[i];
    make_sigma();
}

/* Process model (equations 37 and 38), the bias subtracted. */
static void process(const double *s, const double *w, const double *u, double *next)
{
    const double q1 = s[0], q2 = s[1], q3 = s[2], q0 = s[3], half = dt / 2.0;
    const double r1 = u[0] - s[4], r2 = u[1] - s[5], r3 = u[2] - s[6];
    next[0] = q1 + dt * w[0] + half * (q0 * r1 + q2 * r3 - q3 * r2);
    next[1] = q2 + dt * w[1] + half * (q0 * r2 + q3 * r1 - q1 * r3);
    next[2] = q3 + dt * w[2] + half * (q0 * r3 + q1 * r2 - q2 * r1);
    next[3] = q0 + dt * w[3] - half * (q1 * r1 + q2 * r2 + q3 * r3);
    for (int i = 4; i < STATES; i++)
        next[i] = s[i] + dt * w[i];
}

/* Observation model (equation 39 with the matrix of equation 40). */
static void observe(const double *s, const double *v, double *z)
{
    const double q1 = s[0], q2 = s[1], q3 = s[2], q0 = s[3];
    z[0] = v[0] + 2.0 * (q0 * q2 + q1 * q3);
    z[1] = v[1] + 2.0 * (q2 * q3 - q0 * q1);
    z[2] = v[2] + q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3;
    z[3] = v[3] + q0 * q0 + q1 * q1 - q2 * q2 - q3 * q3;
    z[4] = v[4] + 2.0 * (q1 * q2 + q0 * q3);
    z[5] = v[5] + 2.0 * (q1 * q3 - q0 * q2);
}

/* Sigma points of the augmented state (equation 8). */
static int draw(void)
{
    gsl_matrix_set_zero(augmented);
    gsl_matrix_view block = gsl_matrix_submatrix(augmented, 0, 0, STATES, STATES);
    gsl_matrix_memcpy(&block.matrix, P);
    block = gsl_matrix_submatrix(augmented, STATES, STATES, STATES, STATES);
    gsl_matrix_memcpy(&block.matrix, Q);
    block = gsl_matrix_submatrix(augmented, 2 * STATES, 2 * STATES, OBSERVATIONS, OBSERVATIONS);
    gsl_matrix_memcpy(&block.matrix, R);
    if (gsl_linalg_cholesky_decomp1(augmented))
        return 1;
    for (int i = 0; i < M; i++)
        for (int j = i + 1; j < M; j++)
            gsl_matrix_set(augmented, i, j, 0.0);
    gsl_blas_dgemm(CblasNoTrans, CblasNoTrans, 1.0, augmented, sigma, 0.0, points);
    for (int k = 0; k < N; k++)
        for (int i = 0; i < STATES; i++)
            gsl_matrix_set(points, i, k, gsl_matrix_get(points, i, k) + gsl_vector_get(x, i));
    return 0;
}

static void propagate(const double *u)
{
    double column[M], next[STATES];
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < M; i++)
            column[i] = gsl_matrix_get(points, i, k);
        process(column, column + STATES, u, next);
        for (int i = 0; i < STATES; i++)
            gsl_matrix_set(transformed, i, k, next[i]);
    }
}

static void observe_all(void)
{
    double column[STATES], noise[OBSERVATIONS], seen[OBSERVATIONS];
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < STATES; i++)
            column[i] = gsl_matrix_get(transformed, i, k);
        for (int i = 0; i < OBSERVATIONS; i++)
            noise[i] = gsl_matrix_get(points, 2 * STATES + i, k);
        observe(column, noise, seen);
        for (int i = 0; i < OBSERVATIONS; i++)
            gsl_matrix_set(observed, i, k, seen[i]);
    }
}

/* Mean of columns, and their residuals. */
static void reduce(const gsl_matrix *columns, gsl_vector *mean, gsl_matrix *residuals)
{
    gsl_blas_dgemv(CblasNoTrans, 1.0, columns, weights, 0.0, mean);
    for (size_t i = 0; i < columns->size1; i++)
        for (int k = 0; k < N; k++)
            gsl_matrix_set(residuals, i, k, gsl_matrix_get(columns, i, k) - gsl_vector_get(mean, i));
}

/* result = a diag(weights) b^T */
static void covariance(const gsl_matrix *a, const gsl_matrix *b, gsl_matrix *scratch,
                       gsl_matrix *result)
{
    for (size_t i = 0; i < b->size1; i++)
        for (int k = 0; k < N; k++)
            gsl_matrix_set(scratch, i, k, gsl_matrix_get(b, i, k) * gsl_vector_get(weights, k));
    gsl_blas_dgemm(CblasNoTrans, CblasTrans, 1.0, a, scratch, 0.0, result);
}

static int iterate(const double *u, const double *z, double *estimate)
{
    MARK(SIG_GEN);
    if (draw())
        return 1;

    MARK(MODELS);
    propagate(u);

    MARK(PREDICT); /* equations 10 and 11 */
    reduce(transformed, x, x_residuals);
    gsl_matrix_view scratch = gsl_matrix_submatrix(points, 0, 0, STATES, N);
    covariance(x_residuals, x_residuals, &scratch.matrix, P);

    MARK(MODELS);
    observe_all();

    MARK(UPDATE); /* equations 13 to 18 */
    reduce(observed, z_mean, z_residuals);
    covariance(z_residuals, z_residuals, weighted, S);
    covariance(x_residuals, z_residuals, weighted, cross);
    for (int i = 0; i < OBSERVATIONS; i++)
        gsl_vector_set(innovation, i, z[i] - gsl_vector_get(z_mean, i));
    gsl_matrix_memcpy(S_inverse, S);
    if (gsl_linalg_cholesky_decomp1(S_inverse))
        return 1;
    gsl_linalg_cholesky_invert(S_inverse);
    gsl_blas_dgemm(CblasNoTrans, CblasNoTrans, 1.0, cross, S_inverse, 0.0, K);
    gsl_blas_dgemv(CblasNoTrans, 1.0, K, innovation, 1.0, x);
    gsl_blas_dgemm(CblasNoTrans, CblasNoTrans, 1.0, K, S, 0.0, KS);
    gsl_blas_dgemm(CblasNoTrans, CblasTrans, -1.0, KS, K, 1.0, P);
    MARK(OUTSIDE);

    for (int i = 0; i < STATES; i++)
        estimate[i] = gsl_vector_get(x, i);
    return 0;
}

const struct filter gsl_filter = {"gsl", initialise, iterate};

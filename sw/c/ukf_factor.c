#include "ukf_factor.h"

#include <float.h>
#include <math.h>
#include <string.h>

/** Relative rounding error of ukf_real. */
#define EPSILON (sizeof(ukf_real) == sizeof(double) ? DBL_EPSILON : (double)FLT_EPSILON)

/** Part of the tolerance that is tried first: less than other rounding errors. */
#define LEAST_PART 0x1p-6

double ukf_rounding_errors(uint32_t size)
{
    return 4.0 * size * EPSILON;
}

/** Element of the mean of A and its transpose: A itself if they are equal. */
static ukf_real element(uint32_t size, const ukf_real *A, uint32_t i, uint32_t j)
{
    const ukf_real lower = A[i * size + j];

    return lower + (A[j * size + i] - lower) / 2;
}

/**
 * Power of two above the root of a variance; 0 for 0. Divided by those of its row and column, a
 * matrix has a diagonal between 1/4 and 1, without rounding.
 */
static double scale(ukf_real variance)
{
    const double root = sqrt((double)variance);
    double power;
    uint64_t word;

    memcpy(&word, &root, sizeof word);
    word &= UINT64_C(0x7FF0000000000000); /* without its fraction */
    memcpy(&power, &word, sizeof power);
    return 2.0 * power;
}

/** Whether a diagonal is not negative, with nothing beside a zero. */
static bool is_diagonal_valid(uint32_t size, const ukf_real *A)
{
    for (uint32_t i = 0; i < size; i++) {
        const ukf_real variance = A[i * size + i];

        for (uint32_t j = 0; j < size; j++) {
            if (!(variance > 0) && (variance < 0 || element(size, A, i, j) != 0)) {
                return false;
            }
        }
    }
    return true;
}

/**
 * Cholesky factor, in units of the scales: of A with `shift` added to its diagonal, and with zero
 * columns for pivots up to `least`. Whether there was no such pivot, beside those of zero rows.
 */
static bool factorise(uint32_t size, const ukf_real *A, double shift, double least, ukf_real *B)
{
    bool full = true;

    for (uint32_t i = 0; i < size * size; i++) {
        B[i] = 0;
    }
    for (uint32_t j = 0; j < size; j++) {
        const double unit = scale(A[j * size + j]) * scale(A[j * size + j]);
        ukf_real root = 0;

        for (uint32_t i = j; i < size; i++) {
            ukf_real rest = element(size, A, i, j);

            if (i == j) {
                rest = (ukf_real)((double)rest + shift * unit);
            }
            for (uint32_t k = 0; k < j; k++) {
                rest -= B[i * size + k] * B[j * size + k];
            }
            if (i > j) {
                B[i * size + j] = rest / root;
                continue;
            }
            if (!((double)rest > least * unit)) {
                full = full && unit == 0.0;
                break;
            }
            root = (ukf_real)sqrt((double)rest);
            B[j * size + j] = root;
        }
    }
    return full;
}

/** Whether A and B B^T differ by no more than that, in units of the scales. */
static bool is_factor(uint32_t size, const ukf_real *A, double tolerance, const ukf_real *B)
{
    for (uint32_t i = 0; i < size; i++) {
        for (uint32_t j = 0; j <= i; j++) {
            const double unit = scale(A[i * size + i]) * scale(A[j * size + j]);
            double rest = (double)element(size, A, i, j);

            for (uint32_t k = 0; k <= j; k++) {
                rest -= (double)B[i * size + k] * (double)B[j * size + k];
            }
            if (!(fabs(rest) <= tolerance * unit)) {
                return false;
            }
        }
    }
    return true;
}

bool ukf_lower_factor(uint32_t size, const ukf_real *A, ukf_real *B)
{
    const double tolerance = ukf_rounding_errors(size);

    if (!is_diagonal_valid(size, A)) {
        return false;
    }
    if (factorise(size, A, 0.0, 0.0, B)) {
        return true;
    }
    /*
     * Zero columns for pivots that are zero but for rounding. But a pivot that is small and not zero
     * magnifies the rounding errors of those after it; then something is added to the diagonal.
     *
     * Only if no eigenvalue is below -shift, a matrix has a Cholesky factor with `shift` on its
     * diagonal, but for rounding; and that is accurate, however small the pivots are (N. J. Higham,
     * Accuracy and Stability of Numerical Algorithms, 2nd ed., theorems 10.3 and 10.7). So no
     * eigenvalues are computed. The smallest part of the tolerance that will do is taken.
     */
    for (double part = LEAST_PART * tolerance; part <= tolerance; part *= 2.0) {
        (void)factorise(size, A, 0.0, tolerance, B);
        if (is_factor(size, A, part, B) || factorise(size, A, part, 0.0, B)) {
            return true;
        }
    }
    return false;
}

bool ukf_is_definite(uint32_t size, const ukf_real *A, ukf_real *scratch)
{
    for (uint32_t i = 0; i < size; i++) {
        if (!(A[i * size + i] > 0)) {
            return false;
        }
    }
    /* An eigenvalue is at least so large if there is a factor without it. */
    return factorise(size, A, -ukf_rounding_errors(size), 0.0, scratch);
}

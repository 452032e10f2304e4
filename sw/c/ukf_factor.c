#include "ukf_factor.h"

#include <float.h>
#include <math.h>

/** Largest number of this part of the diagonal that is a rounding error of zero. */
#define ZERO_PIVOT (sizeof(ukf_real) == sizeof(double) ? 1e-14 : 1e-6)

/** Copy the lower triangle, with zeros above it. */
static void copy_lower(uint32_t size, const ukf_real *A, ukf_real *B)
{
    for (uint32_t i = 0; i < size; i++) {
        for (uint32_t j = 0; j < size; j++) {
            B[i * size + j] = j <= i ? A[i * size + j] : (ukf_real)0;
        }
    }
}

/** Divide column j of the remainder by the root of its pivot, and take its product from the rest. */
static void eliminate(uint32_t size, ukf_real *B, uint32_t j)
{
    const ukf_real root = (ukf_real)sqrt((double)B[j * size + j]);

    B[j * size + j] = root;
    for (uint32_t i = j + 1; i < size; i++) {
        B[i * size + j] /= root;
    }
    for (uint32_t i = j + 1; i < size; i++) {
        for (uint32_t k = j + 1; k <= i; k++) {
            B[i * size + k] -= B[i * size + j] * B[k * size + j];
        }
    }
}

/** Factor of a positive definite matrix; false if a pivot is not positive. */
static bool definite_factor(uint32_t size, const ukf_real *A, ukf_real *B)
{
    copy_lower(size, A, B);
    for (uint32_t j = 0; j < size; j++) {
        if (!(B[j * size + j] > 0)) {
            return false;
        }
        eliminate(size, B, j);
    }
    return true;
}

bool ukf_lower_factor(uint32_t size, const ukf_real *A, ukf_real *B)
{
    if (definite_factor(size, A, B)) {
        return true;
    }
    copy_lower(size, A, B);
    for (uint32_t j = 0; j < size; j++) {
        const double part = ZERO_PIVOT * size;
        const double own = (double)A[j * size + j];
        const double tolerance = part * own;

        if ((double)B[j * size + j] > tolerance) {
            eliminate(size, B, j);
            continue;
        }
        if (!((double)B[j * size + j] >= -tolerance)) {
            return false;
        }
        /* |a_ij| <= sqrt(a_ii a_jj): beside a zero pivot the column must be zero as well. */
        for (uint32_t i = j; i < size; i++) {
            const double limit = sqrt(part * fabs(own * (double)A[i * size + i]));

            if (fabs((double)B[i * size + j]) > fmax(limit, tolerance)) {
                return false;
            }
            B[i * size + j] = 0;
        }
    }
    return true;
}

/**
 * @file
 * @brief Square roots of covariances.
 */
#ifndef UKF_FACTOR_H
#define UKF_FACTOR_H

#include <stdbool.h>
#include <stdint.h>

#include "ukf_real.h"

#ifdef __cplusplus
extern "C" {
#endif

/** @brief What rounding leaves of a zero, in a matrix of so many rows with a diagonal near 1. */
double ukf_rounding_errors(uint32_t size);

/**
 * @brief Lower triangular B with A = B B^T, for positive semidefinite A.
 *
 * For positive definite A this is the Cholesky factor. A pivot that is zero, but for rounding, gives
 * a zero column where that is accurate. A and B B^T differ by rounding errors: each element by a few
 * times `size` epsilons of ukf_real, relative to the root of the product of the diagonal elements
 * of its row and column.
 *
 * @param size Rows and columns.
 * @param A    Matrix, row by row; if it is not quite symmetric, the mean of it and its transpose.
 * @param B    The factor, row by row; zero above the diagonal. Must not be A.
 * @return false if A is not positive semidefinite, beyond its rounding errors.
 */
bool ukf_lower_factor(uint32_t size, const ukf_real *A, ukf_real *B);

/**
 * @brief Whether A is positive definite, beyond its rounding errors.
 * @param size    Rows and columns.
 * @param A       Matrix as for ukf_lower_factor().
 * @param scratch As many numbers. Must not be A.
 */
bool ukf_is_definite(uint32_t size, const ukf_real *A, ukf_real *scratch);

#ifdef __cplusplus
}
#endif

#endif

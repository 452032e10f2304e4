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

/**
 * @brief Lower triangular B with A = B B^T, for positive semidefinite A.
 *
 * For positive definite A this is the Cholesky factor. A pivot that is zero, but for rounding, gives
 * a zero column.
 *
 * @param size Rows and columns.
 * @param A    Symmetric matrix, row by row.
 * @param B    The factor, row by row; zero above the diagonal. Must not be A.
 * @return false if A is not positive semidefinite.
 */
bool ukf_lower_factor(uint32_t size, const ukf_real *A, ukf_real *B);

#ifdef __cplusplus
}
#endif

#endif

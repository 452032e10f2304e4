/**
 * @file
 * @brief Type of numbers in software.
 */
#ifndef UKF_REAL_H
#define UKF_REAL_H

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

/*
 * Models compute in double by default, as the Python software does, also for cores of binary32:
 * what goes to the core is rounded once, on its way to the bus. -DUKF_REAL=float computes in single
 * precision, which is faster on small processors; the estimates then differ in the last digits.
 */
#ifndef UKF_REAL
#define UKF_REAL double
#endif

/** Number in software. */
typedef UKF_REAL ukf_real;

/** Whether a number is not NaN, by its bits: -ffast-math (-Ofast) breaks isnan() and isfinite(). */
static inline bool ukf_is_number(double value)
{
    uint64_t word;

    memcpy(&word, &value, sizeof word);
    return (word & UINT64_C(0x7FFFFFFFFFFFFFFF)) <= UINT64_C(0x7FF0000000000000);
}

/** Whether a number is neither NaN nor infinite. */
static inline bool ukf_is_finite(double value)
{
    uint64_t word;

    memcpy(&word, &value, sizeof word);
    return (word & UINT64_C(0x7FF0000000000000)) != UINT64_C(0x7FF0000000000000);
}

#ifdef __cplusplus
}
#endif

#endif

/**
 * @file
 * @brief Type of numbers in software.
 */
#ifndef UKF_REAL_H
#define UKF_REAL_H

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

#ifdef __cplusplus
}
#endif

#endif

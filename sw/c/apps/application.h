/**
 * @file
 * @brief What an application is: its models.
 *
 * Those that `ukf generate` writes are one, with problem_application.c. For models of your own you
 * write one C file with this function and the models.
 *
 * @code
 * #include "application.h"
 * #include "ukf_core.h"
 *
 * static bool process(void *context, const ukf_real *x, const ukf_real *w, const void *input,
 *                     ukf_real *next)
 * {
 *     const ukf_real *u = input;
 *     ...
 *     return true;
 * }
 *
 * static bool observe(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z) { ... }
 *
 * const struct ukf_models *ukf_application(const struct ukf_scenario *scenario)
 * {
 *     static const struct ukf_sensor sensors[] = {{.observe = observe, .terms = UKF_R}};
 *     static const struct ukf_models models = {.process = process, .sensors = sensors};
 *
 *     return scenario->n == 2u && scenario->m == 1u && scenario->inputs == 1u ? &models : NULL;
 * }
 * @endcode
 *
 * The input of the process model is an array of the numbers that the scenario has for each step.
 *
 * What a core has itself (UKF_HAS_F, UKF_HAS_H) is not called, and may be NULL. With h on the core the
 * sensors are those of the scenario, with f as well the function is not needed, and no file either.
 *
 * For results that equal those of models in Python to the last bit, compute in the same order, with
 * +, -, *, / and sqrt() only, in double, and compile with -ffp-contract=off. exp(), sin() and the
 * like differ between libraries in the last bit.
 */
#ifndef UKF_APPLICATION_H
#define UKF_APPLICATION_H

#include "scenario.h"
#include "ukf_filter.h"

#ifdef __cplusplus
extern "C" {
#endif

/**
 * @brief Give the models for a scenario; the application has this function.
 * @param scenario Its sizes are those of the core; that has been checked. It outlives the models,
 *                 which may depend on its interval.
 * @return The models, which must stay as they are; NULL if they are not for such a scenario.
 */
const struct ukf_models *ukf_application(const struct ukf_scenario *scenario);

#ifdef __cplusplus
}
#endif

#endif

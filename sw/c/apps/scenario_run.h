/**
 * @file
 * @brief Run the models of an application over a scenario, on the core of ukf_core.h.
 *
 * Nothing is allocated, so a program without an operating system can do it.
 */
#ifndef UKF_SCENARIO_RUN_H
#define UKF_SCENARIO_RUN_H

#include <stdbool.h>

#include "scenario.h"
#include "ukf_core.h"
#include "ukf_driver.h"

#ifdef __cplusplus
extern "C" {
#endif

/** A run of the filter over a scenario. */
struct ukf_run {
    const struct ukf_port *port; /**< Way to a core that was generated with this ukf_core.h. */
    const struct ukf_scenario *scenario;
    uint32_t timeout_us; /**< How long to wait for a step of the core, in microseconds. */
    bool covariances;    /**< Whether P is read after each step: a step of the core, and words. */
    /** Called after each step, with its number, the estimate, and P or NULL; NULL is nobody. */
    void (*on_step)(void *context, uint32_t step, const ukf_real *x, const ukf_real *P,
                    const struct ukf_record *record);
    void *context;            /**< First argument of on_step. */
    ukf_real P[UKF_N * UKF_N]; /**< Covariance as last read; at the end, the last. */
    uint32_t errors;          /**< Steps that failed. */
    uint32_t recoveries;      /**< Failures after which the filter had to be recovered. */
    struct ukf_fault fault;   /**< Details of the last failure. */
    const char *complaint;    /**< What does not fit together, so that nothing was run; or NULL. */
};

/**
 * @brief Run the filter over all samples, one run at a time.
 *
 * A step predicts, then updates with every sensor of which something was sampled, in the order of
 * their rows; the first of them with ukf_iterate(). Models on the core are told what the scenario has.
 *
 * When a step fails the rest of the sample is dropped. If the core or the bus failed, the filter is
 * recovered before the next, and begins anew if the estimate is lost. If that fails, the run ends.
 *
 * @return UKF_OK if the run came to its end; otherwise what ended it. UKF_BAD_ARGUMENT with a complaint
 *         if scenario, core and models do not fit together.
 */
enum ukf_result ukf_run_scenario(struct ukf_run *run);

#ifdef __cplusplus
}
#endif

#endif

/**
 * @file
 * @brief Run an application from a file of samples to a file of estimates.
 */
#ifndef UKF_RUN_FILES_H
#define UKF_RUN_FILES_H

#include <stdbool.h>

#include "ukf_port.h"

#ifdef __cplusplus
extern "C" {
#endif

/**
 * @brief Run a scenario on a core; prints a line about it, or an error.
 *
 * The file of results has, for each step, what ukf_results_write() writes, and at the end the
 * covariance (n by n doubles), if the run came to its end.
 *
 * @param port        Way to a core that was generated with the ukf_core.h of this program.
 * @param scenario    From `ukf export`.
 * @param results     File to be written.
 * @param timeout_us  How long to wait for a step, in microseconds.
 * @param covariances Whether the results have the covariance after each step.
 * @return Exit code: 0, 1 if the core or a file failed, 2 if the scenario is not one, or does not fit
 *         the core or the models.
 */
int ukf_run_files(const struct ukf_port *port, const char *scenario, const char *results,
                  uint32_t timeout_us, bool covariances);

#ifdef __cplusplus
}
#endif

#endif

/**
 * @file
 * @brief Scenarios and results as files, for programs that have files.
 */
#ifndef UKF_SCENARIO_FILE_H
#define UKF_SCENARIO_FILE_H

#include <stdio.h>

#include "scenario.h"
#include "ukf_real.h"

#ifdef __cplusplus
extern "C" {
#endif

/**
 * @brief Read what `ukf export` wrote to scenario.bin.
 * @param path     The file.
 * @param scenario To be filled in; ukf_scenario_free() gives its memory back.
 * @return NULL, or what is wrong with the file.
 */
const char *ukf_scenario_read(const char *path, struct ukf_scenario *scenario);

/** @brief Give the memory of a scenario back. */
void ukf_scenario_free(struct ukf_scenario *scenario);

/** @brief Append numbers as doubles. @return false if the file cannot be written. */
bool ukf_numbers_write(FILE *file, uint32_t count, const ukf_real *values);

/**
 * @brief Append the result of a step: x, n doubles; P, n by n, unless it is NULL; a struct ukf_record.
 * @return false if the file cannot be written.
 */
bool ukf_results_write(FILE *file, uint32_t n, const ukf_real *x, const ukf_real *P,
                       const struct ukf_record *record);

#ifdef __cplusplus
}
#endif

#endif

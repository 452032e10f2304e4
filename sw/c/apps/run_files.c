#include "run_files.h"

#include <inttypes.h>
#include <stddef.h>
#include <stdio.h>

#include "scenario_file.h"
#include "scenario_run.h"

struct results {
    FILE *file;
    const struct ukf_run *run;
    bool written;
};

static void write_step(void *context, uint32_t step, const ukf_real *x, const ukf_real *P,
                       const struct ukf_record *record)
{
    struct results *results = context;

    results->written =
        results->written && ukf_results_write(results->file, UKF_N, x, P, record);
    if (record->result != UKF_OK) {
        const struct ukf_fault *fault = &results->run->fault;

        (void)fprintf(stderr, "step %" PRIu32 ": %s (%" PRIu32 ")", step,
                      ukf_result_name((enum ukf_result)record->result), record->result);
        if (record->result == UKF_BAD_MODEL) {
            (void)fprintf(stderr, ": failed or not finite at sigma point %" PRIu32 ", row %" PRIu32,
                          fault->point, fault->index);
        }
        (void)fputc('\n', stderr);
    }
}

static void explain(const struct ukf_run *run, enum ukf_result result)
{
    const struct ukf_scenario *scenario = run->scenario;
    const struct ukf_fault *fault = &run->fault;

    if (run->complaint != NULL) {
        (void)fprintf(stderr,
                      "%s: the scenario has n %" PRIu32 ", m %" PRIu32 ", q %" PRIu32 ", r %" PRIu32
                      ", inputs %" PRIu32 ", the core n %u, m %u, q %u, r %u\n",
                      run->complaint, scenario->n, scenario->m, scenario->q, scenario->r,
                      scenario->inputs, UKF_N, UKF_M, UKF_Q, UKF_R);
        return;
    }
    (void)fprintf(stderr,
                  "%s: step %" PRIu32 ", code %" PRIu32 ", index %" PRIu32 ", address 0x%" PRIx32
                  ", expected 0x%" PRIx32 ", found 0x%" PRIx32 "\n",
                  ukf_result_name(result), fault->step, fault->code, fault->index, fault->address,
                  fault->expected, fault->found);
}

int ukf_run_files(const struct ukf_port *port, const char *scenario_path, const char *results_path,
                  uint32_t timeout_us, bool covariances)
{
    struct ukf_scenario scenario;
    struct results results = {.written = true};
    struct ukf_run run = {
        .port = port,
        .scenario = &scenario,
        .timeout_us = timeout_us,
        .covariances = covariances,
        .on_step = write_step,
        .context = &results,
    };
    enum ukf_result result;
    const char *complaint;

    results.run = &run;
    complaint = ukf_scenario_read(scenario_path, &scenario);
    if (complaint != NULL) {
        (void)fprintf(stderr, "%s: %s\n", scenario_path, complaint);
        return 2;
    }
    results.file = fopen(results_path, "wb");
    if (results.file == NULL) {
        (void)fprintf(stderr, "%s: cannot be written\n", results_path);
        ukf_scenario_free(&scenario);
        return 1;
    }
    result = ukf_run_scenario(&run);
    if (result == UKF_OK) {
        results.written = ukf_numbers_write(results.file, UKF_N * UKF_N, run.P) &&
                          results.written;
    } else {
        explain(&run, result);
    }
    results.written = fclose(results.file) == 0 && results.written;
    (void)printf("%" PRIu32 " steps, %" PRIu32 " errors, %" PRIu32 " recoveries\n", scenario.steps,
                 run.errors, run.recoveries);
    ukf_scenario_free(&scenario);
    if (run.complaint != NULL) {
        return 2;
    }
    return result == UKF_OK && results.written ? 0 : 1;
}

/**
 * @file
 * @brief An application as a program without an operating system, for a Cortex-A9 of a Zynq-7000.
 *
 * It runs the samples of the generated scenario_data.h and leaves the outcome in `ukf_run_outcome`,
 * for a debugger. Start-up code, the interrupt controller and the global timer are those of your board
 * support package; it must call ukf_run_interrupt() for the interrupt of the core if
 * UKF_RUN_INTERRUPTS is 1.
 */
#include "bare_metal.h"
#include "scenario_data.h"
#include "scenario_run.h"

/** The global timer of a Zynq-7000, and its frequency in MHz. */
#ifndef UKF_RUN_TIMER
#define UKF_RUN_TIMER 0xF8F00200u
#endif
#ifndef UKF_RUN_TIMER_MHZ
#define UKF_RUN_TIMER_MHZ 333u
#endif
/** 1: wait for interrupts; 0: poll. */
#ifndef UKF_RUN_INTERRUPTS
#define UKF_RUN_INTERRUPTS 0
#endif

/** What came of the run. */
struct ukf_run_outcome {
    uint32_t ended;         /**< 1 when the others are valid. */
    uint32_t result;        /**< enum ukf_result of the run. */
    uint32_t steps;         /**< Steps that were run. */
    uint32_t errors;        /**< Steps that failed. */
    uint32_t recoveries;    /**< Failures after which it went on. */
    uint64_t microseconds;  /**< Time that it took. */
    ukf_real x[UKF_N];      /**< The last estimate. */
};

volatile struct ukf_run_outcome ukf_run_outcome;

static uint64_t now_us(void)
{
    return ukf_global_timer_us((const volatile uint32_t *)(uintptr_t)UKF_RUN_TIMER,
                               UKF_RUN_TIMER_MHZ);
}

static struct ukf_bare_metal state = {.base = UKF_BASE_ADDRESS, .now_us = now_us};

void ukf_run_interrupt(void);

/** Handler of the core's interrupt. */
void ukf_run_interrupt(void)
{
    ukf_bare_metal_interrupt(&state);
}

static void note_step(void *context, uint32_t step, const ukf_real *x, const ukf_real *P,
                      const struct ukf_record *record)
{
    (void)context;
    (void)P;
    (void)record;
    ukf_run_outcome.steps = step + 1u;
    for (uint32_t i = 0; i < UKF_N; i++) {
        ukf_run_outcome.x[i] = x[i];
    }
}

int main(void)
{
    const struct ukf_port port = ukf_bare_metal_port(&state, UKF_RUN_INTERRUPTS);
    struct ukf_run run = {
        .port = &port,
        .scenario = &ukf_scenario_data,
        .timeout_us = UKF_DEFAULT_TIMEOUT_US,
        .on_step = note_step,
    };
    const uint64_t start = now_us();

    ukf_run_outcome.result = ukf_run_scenario(&run);
    ukf_run_outcome.errors = run.errors;
    ukf_run_outcome.recoveries = run.recoveries;
    ukf_run_outcome.microseconds = now_us() - start;
    ukf_run_outcome.ended = 1u;
    return 0;
}

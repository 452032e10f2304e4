/**
 * @file
 * @brief The nanosatellite as a program without an operating system, for a Cortex-A9 of a Zynq-7000.
 *
 * It runs the samples of the generated scenario_data.h and leaves the outcome in `nanosat_outcome`,
 * for a debugger. Start-up code, the interrupt controller and the global timer are those of your board
 * support package; it must call nanosat_interrupt() for the interrupt of the core if
 * NANOSAT_INTERRUPTS is 1.
 */
#include "bare_metal.h"
#include "nanosat.h"
#include "scenario_data.h"
#include "ukf_core.h"

/** The global timer of a Zynq-7000, and its frequency in MHz. */
#ifndef NANOSAT_TIMER
#define NANOSAT_TIMER 0xF8F00200u
#endif
#ifndef NANOSAT_TIMER_MHZ
#define NANOSAT_TIMER_MHZ 333u
#endif
/** 1: wait for interrupts; 0: poll. */
#ifndef NANOSAT_INTERRUPTS
#define NANOSAT_INTERRUPTS 0
#endif

/** What came of the run. */
struct nanosat_outcome {
    uint32_t ended;         /**< 1 when the others are valid. */
    uint32_t result;        /**< enum ukf_result of the run. */
    uint32_t steps;         /**< Steps that were run. */
    uint32_t errors;        /**< Steps that failed. */
    uint32_t recoveries;    /**< Failures after which it went on. */
    uint64_t microseconds;  /**< Time that it took. */
    ukf_real x[NANOSAT_STATES]; /**< The last estimate. */
};

volatile struct nanosat_outcome nanosat_outcome;

static uint64_t now_us(void)
{
    return ukf_global_timer_us((const volatile uint32_t *)(uintptr_t)NANOSAT_TIMER,
                               NANOSAT_TIMER_MHZ);
}

static struct ukf_bare_metal state = {.base = UKF_BASE_ADDRESS, .now_us = now_us};

void nanosat_interrupt(void);

/** Handler of the core's interrupt. */
void nanosat_interrupt(void)
{
    ukf_bare_metal_interrupt(&state);
}

static void note_step(void *context, uint32_t step, const ukf_real *x, const ukf_real *P,
                      const struct ukf_record *record)
{
    (void)context;
    (void)P;
    (void)record;
    nanosat_outcome.steps = step + 1u;
    for (uint32_t i = 0; i < NANOSAT_STATES; i++) {
        nanosat_outcome.x[i] = x[i];
    }
}

int main(void)
{
    static const struct ukf_core core = UKF_CORE_INITIALISER;
    const struct ukf_port port = ukf_bare_metal_port(&state, NANOSAT_INTERRUPTS);
    struct nanosat_run run = {
        .core = &core,
        .port = &port,
        .scenario = &ukf_scenario_data,
        .timeout_us = UKF_DEFAULT_TIMEOUT_US,
        .on_step = note_step,
    };
    const uint64_t start = now_us();

    nanosat_outcome.result = nanosat_execute(&run);
    nanosat_outcome.errors = run.errors;
    nanosat_outcome.recoveries = run.recoveries;
    nanosat_outcome.microseconds = now_us() - start;
    nanosat_outcome.ended = 1u;
    return 0;
}

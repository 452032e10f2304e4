/**
 * @file
 * @brief Port without an operating system: the core in the address space, an interrupt handler.
 *
 * An access that the core refuses (SLVERR) is a data abort here; the driver makes none, unless
 * something else starts the core as well.
 */
#ifndef UKF_PORT_BARE_METAL_H
#define UKF_PORT_BARE_METAL_H

#include <stdbool.h>
#include <stdint.h>

#include "ukf_port.h"

#ifdef __cplusplus
extern "C" {
#endif

/** State of a port. */
struct ukf_bare_metal {
    uintptr_t base;           /**< Where the core is, for accesses that are not cached. */
    uint64_t (*now_us)(void); /**< Time in microseconds; ukf_global_timer_us() for instance. */
    volatile bool interrupted;
};

/**
 * @brief Make a port.
 * @param state      Filled in by the caller; must outlive the port.
 * @param interrupts Whether ukf_bare_metal_interrupt() is called by the handler. If not, the driver
 *                   polls.
 */
struct ukf_port ukf_bare_metal_port(struct ukf_bare_metal *state, bool interrupts);

/** @brief To be called by the handler of the core's interrupt: silences the line, wakes the driver. */
void ukf_bare_metal_interrupt(struct ukf_bare_metal *state);

/**
 * @brief Time from the global timer of a Cortex-A9, which must run.
 * @param registers      Its registers: 0xF8F00200 on a Zynq-7000.
 * @param ticks_per_us   Its frequency in MHz: half of that of the processor, 333 at 667 MHz.
 */
uint64_t ukf_global_timer_us(const volatile uint32_t *registers, uint32_t ticks_per_us);

#ifdef __cplusplus
}
#endif

#endif

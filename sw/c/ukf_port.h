/**
 * @file
 * @brief What the driver needs of a system: the only part that differs between bare metal, Linux and
 * a simulation.
 */
#ifndef UKF_PORT_H
#define UKF_PORT_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/**
 * @brief Way to one core.
 *
 * Addresses are in bytes, relative to the core, and multiples of 4.
 */
struct ukf_port {
    /** First argument of all functions. */
    void *context;
    /** Read a word. @return false if the core refused the access, if the system can tell. */
    bool (*read)(void *context, uint32_t address, uint32_t *word);
    /** Write a word. @return false if the core refused the access, if the system can tell. */
    bool (*write)(void *context, uint32_t address, uint32_t word);
    /**
     * Wait until the interrupt line is high, at most so many microseconds; 0 looks only.
     * NULL has the driver poll. @return whether the line is high, or has been since the last call.
     */
    bool (*wait)(void *context, uint32_t timeout_us);
    /** Time in microseconds since any moment; it never goes back. */
    uint64_t (*now_us)(void *context);
};

#ifdef __cplusplus
}
#endif

#endif

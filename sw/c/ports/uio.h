/**
 * @file
 * @brief Port for Linux: the core through UIO, as the generated device tree overlay offers it.
 *
 * An access that the core refuses (SLVERR) is a bus error of the processor, SIGBUS.
 */
#ifndef UKF_PORT_UIO_H
#define UKF_PORT_UIO_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "ukf_port.h"

#ifdef __cplusplus
extern "C" {
#endif

/** State of a port. */
struct ukf_uio {
    int device;
    volatile uint32_t *words;
    size_t length; /**< Bytes. */
};

/**
 * @brief Open a device and make a port.
 * @param state      To be filled in; must outlive the port.
 * @param port       To be filled in.
 * @param path       "/dev/uio0", for instance.
 * @param length     Bytes to map: 1 << UKF_ADDRESS_BITS of the generated header.
 * @param interrupts Whether to wait for interrupts; otherwise the driver polls.
 * @return 0, or the number of the system's error (errno).
 */
int ukf_uio_open(struct ukf_uio *state, struct ukf_port *port, const char *path, size_t length,
                 bool interrupts);

/** @brief Give the device back. */
void ukf_uio_close(struct ukf_uio *state);

#ifdef __cplusplus
}
#endif

#endif

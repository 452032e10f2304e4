/**
 * @file
 * @brief Port to a model of the core in another process, over a socket of the Unix domain.
 *
 * The other side is ukf_tools.arm.register_server in Python. A request has 4 words of 32 bits in the
 * byte order of the machine: operation (0 read, 1 write, 2 wait), address, data or time-out in
 * microseconds, 0. An answer has 2: 1 for success, and data.
 */
#ifndef UKF_PORT_REMOTE_H
#define UKF_PORT_REMOTE_H

#include <stdbool.h>

#include "ukf_port.h"

#ifdef __cplusplus
extern "C" {
#endif

/** State of a port. */
struct ukf_remote {
    int socket;
};

/**
 * @brief Connect and make a port.
 * @param state      To be filled in; must outlive the port.
 * @param port       To be filled in.
 * @param path       Of the socket.
 * @param interrupts Whether to wait for interrupts; otherwise the driver polls.
 * @return 0, or the number of the system's error (errno).
 */
int ukf_remote_open(struct ukf_remote *state, struct ukf_port *port, const char *path,
                    bool interrupts);

/** @brief Hang up. */
void ukf_remote_close(struct ukf_remote *state);

#ifdef __cplusplus
}
#endif

#endif

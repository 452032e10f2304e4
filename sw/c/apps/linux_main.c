/**
 * @file
 * @brief An application as a program for Linux.
 *
 * `ukf_run uio:/dev/uio0 scenario.bin results.bin` drives the core in the programmable logic;
 * `ukf_run remote:SOCKET ...` a model of it in another process. A fourth argument, `polling`, has the
 * driver poll instead of waiting for interrupts.
 */
#include <stdio.h>
#include <string.h>

#include "remote.h"
#include "run_files.h"
#include "uio.h"
#include "ukf_core.h"
#include "ukf_driver.h"

/** What follows a prefix, or NULL. */
static const char *after(const char *text, const char *prefix)
{
    return strncmp(text, prefix, strlen(prefix)) == 0 ? text + strlen(prefix) : NULL;
}

int main(int count, char **arguments)
{
    const char *uio = count > 1 ? after(arguments[1], "uio:") : NULL;
    const char *remote = count > 1 ? after(arguments[1], "remote:") : NULL;
    const bool polling = count > 4 && strcmp(arguments[4], "polling") == 0;
    struct ukf_uio device;
    struct ukf_remote connection;
    struct ukf_port port;
    int code;

    if ((uio == NULL && remote == NULL) || count < 4 || count > 5 || (count == 5 && !polling)) {
        (void)fprintf(stderr, "usage: %s uio:DEVICE|remote:SOCKET SCENARIO RESULTS [polling]\n",
                      count > 0 ? arguments[0] : "ukf_run");
        return 2;
    }
    code = uio != NULL
               ? ukf_uio_open(&device, &port, uio, (size_t)1 << UKF_ADDRESS_BITS, !polling)
               : ukf_remote_open(&connection, &port, remote, !polling);
    if (code != 0) {
        (void)fprintf(stderr, "%s: %s\n", arguments[1], strerror(code));
        return 1;
    }
    code = ukf_run_files(&port, arguments[2], arguments[3], UKF_DEFAULT_TIMEOUT_US, false);
    if (uio != NULL) {
        ukf_uio_close(&device);
    } else {
        ukf_remote_close(&connection);
    }
    return code;
}

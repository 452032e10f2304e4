#define _POSIX_C_SOURCE 200809L
#include "remote.h"

#include <errno.h>
#include <stddef.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

enum operation { READ = 0, WRITE = 1, WAIT = 2 };

/** Send all, or receive all. */
static bool move_bytes(int socket, char *bytes, size_t count, bool sending)
{
    while (count > 0u) {
        const ssize_t moved = sending ? send(socket, bytes, count, MSG_NOSIGNAL)
                                      : recv(socket, bytes, count, 0);

        if (moved > 0) {
            bytes += moved;
            count -= (size_t)moved;
        } else if (moved == 0 || errno != EINTR) {
            return false;
        }
    }
    return true;
}

static bool ask(const struct ukf_remote *state, enum operation operation, uint32_t address,
                uint32_t data, uint32_t *answer)
{
    uint32_t request[4] = {(uint32_t)operation, address, data, 0u};
    uint32_t words[2];

    if (!move_bytes(state->socket, (char *)request, sizeof request, true) ||
        !move_bytes(state->socket, (char *)words, sizeof words, false)) {
        return false;
    }
    *answer = words[1];
    return words[0] == 1u;
}

static bool read_word(void *context, uint32_t address, uint32_t *word)
{
    return ask(context, READ, address, 0u, word);
}

static bool write_word(void *context, uint32_t address, uint32_t word)
{
    uint32_t ignored;

    return ask(context, WRITE, address, word, &ignored);
}

static bool wait_for_interrupt(void *context, uint32_t timeout_us)
{
    uint32_t high;

    return ask(context, WAIT, 0u, timeout_us, &high) && high != 0u;
}

static uint64_t now_us(void *context)
{
    struct timespec now;

    (void)context;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

int ukf_remote_open(struct ukf_remote *state, struct ukf_port *port, const char *path,
                    bool interrupts)
{
    struct sockaddr_un name = {.sun_family = AF_UNIX};

    if (strlen(path) >= sizeof name.sun_path) {
        return ENAMETOOLONG;
    }
    memcpy(name.sun_path, path, strlen(path) + 1u);
    state->socket = socket(AF_UNIX, SOCK_STREAM, 0);
    if (state->socket < 0) {
        return errno;
    }
    if (connect(state->socket, (const struct sockaddr *)&name, sizeof name) != 0) {
        const int error = errno;

        (void)close(state->socket);
        return error;
    }
    *port = (struct ukf_port){
        .context = state,
        .read = read_word,
        .write = write_word,
        .wait = interrupts ? wait_for_interrupt : NULL,
        .now_us = now_us,
    };
    return 0;
}

void ukf_remote_close(struct ukf_remote *state)
{
    (void)close(state->socket);
}

#define _POSIX_C_SOURCE 200809L
#include "uio.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

static bool read_word(void *context, uint32_t address, uint32_t *word)
{
    const struct ukf_uio *state = context;

    *word = state->words[address / 4u];
    return true;
}

static bool write_word(void *context, uint32_t address, uint32_t word)
{
    const struct ukf_uio *state = context;

    state->words[address / 4u] = word;
    return true;
}

static uint64_t now_us(void *context)
{
    struct timespec now;

    (void)context;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

static bool wait_for_interrupt(void *context, uint32_t timeout_us)
{
    const struct ukf_uio *state = context;
    struct pollfd event = {.fd = state->device, .events = POLLIN};
    const uint64_t deadline = now_us(NULL) + timeout_us;
    const uint32_t on = 1;
    uint32_t count;

    /* The kernel has switched the interrupt off when it came; a line that is high comes at once. */
    if (write(state->device, &on, sizeof on) != (ssize_t)sizeof on) {
        return false;
    }
    for (;;) {
        const uint64_t now = now_us(NULL);
        const uint64_t left = now < deadline ? deadline - now : 0u;
        const int ready = poll(&event, 1, (int)((left + 999u) / 1000u));

        if (ready > 0) {
            return read(state->device, &count, sizeof count) == (ssize_t)sizeof count;
        }
        if (ready == 0 || errno != EINTR) {
            return false;
        }
    }
}

int ukf_uio_open(struct ukf_uio *state, struct ukf_port *port, const char *path, size_t length,
                 bool interrupts)
{
    const size_t page = (size_t)sysconf(_SC_PAGESIZE);
    void *words;

    state->length = (length + page - 1u) / page * page;
    state->device = open(path, O_RDWR | O_CLOEXEC);
    if (state->device < 0) {
        return errno;
    }
    words = mmap(NULL, state->length, PROT_READ | PROT_WRITE, MAP_SHARED, state->device, 0);
    if (words == MAP_FAILED) {
        const int error = errno;

        (void)close(state->device);
        return error;
    }
    state->words = words;
    *port = (struct ukf_port){
        .context = state,
        .read = read_word,
        .write = write_word,
        .wait = interrupts ? wait_for_interrupt : NULL,
        .now_us = now_us,
    };
    return 0;
}

void ukf_uio_close(struct ukf_uio *state)
{
    (void)munmap((void *)(uintptr_t)state->words, state->length);
    (void)close(state->device);
}

#include "bare_metal.h"

#include <stddef.h>

#include "ukf_registers.h"

/** No processor looks more often than this, so more looks mean that the clock stands still. */
#define LOOKS_PER_US 1000u

static volatile uint32_t *word_at(const struct ukf_bare_metal *state, uint32_t address)
{
    return (volatile uint32_t *)(state->base + address);
}

static bool read_word(void *context, uint32_t address, uint32_t *word)
{
    *word = *word_at(context, address);
    return true;
}

static bool write_word(void *context, uint32_t address, uint32_t word)
{
    *word_at(context, address) = word;
    return true;
}

static uint64_t now_us(void *context)
{
    const struct ukf_bare_metal *state = context;

    return state->now_us();
}

static bool wait_for_interrupt(void *context, uint32_t timeout_us)
{
    struct ukf_bare_metal *state = context;
    const uint64_t start = state->now_us();
    uint64_t looks = (uint64_t)timeout_us * LOOKS_PER_US;
    bool late;

    do {
        /* The clock is read first: an interrupt that comes while we look is not late. */
        late = state->now_us() - start >= timeout_us || looks-- == 0u;
        if (state->interrupted) {
            state->interrupted = false;
            return true;
        }
    } while (!late);
    return false;
}

void ukf_bare_metal_interrupt(struct ukf_bare_metal *state)
{
    *word_at(state, UKF_INTERRUPT_PENDING_OFFSET) =
        UKF_INTERRUPT_PENDING_DONE_MASK | UKF_INTERRUPT_PENDING_ERROR_MASK;
    state->interrupted = true;
}

struct ukf_port ukf_bare_metal_port(struct ukf_bare_metal *state, bool interrupts)
{
    state->interrupted = false;
    return (struct ukf_port){
        .context = state,
        .read = read_word,
        .write = write_word,
        .wait = interrupts ? wait_for_interrupt : NULL,
        .now_us = now_us,
    };
}

uint64_t ukf_global_timer_us(const volatile uint32_t *registers, uint32_t ticks_per_us)
{
    uint32_t high = registers[1];
    uint32_t low = registers[0];
    uint32_t again = registers[1];

    while (again != high) { /* the lower half overflowed in between */
        high = again;
        low = registers[0];
        again = registers[1];
    }
    return ((uint64_t)high << 32 | low) / ticks_per_us;
}

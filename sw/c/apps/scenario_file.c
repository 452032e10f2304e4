#include "scenario_file.h"

#include <stddef.h>
#include <stdlib.h>

/*
 * Little-endian: the words "UKFS", version, n, m, q, r, inputs, steps, redraw, 0; the doubles
 * interval, x0, P0, Q, R, input, measurement; the words of sampled.
 */
#define MAGIC UINT32_C(0x53464B55)
#define VERSION 1u
#define WORDS 10u
#define MAX_SIZE 32u
#define MAX_STEPS UINT32_C(10000000)

static size_t count_numbers(const uint32_t *header)
{
    const size_t n = header[2], m = header[3], q = header[4], r = header[5], inputs = header[6];
    const size_t steps = header[7];

    return 1u + n + n * n + q * q + r * r + steps * (inputs + m);
}

static const char *check(const uint32_t *header)
{
    if (header[0] != MAGIC) {
        return "not a scenario of this byte order";
    }
    if (header[1] != VERSION) {
        return "of another version";
    }
    for (size_t i = 2; i < 7; i++) {
        if (header[i] > MAX_SIZE) {
            return "sizes must be at most 32";
        }
    }
    return header[7] <= MAX_STEPS ? NULL : "too many steps";
}

const char *ukf_scenario_read(const char *path, struct ukf_scenario *scenario)
{
    uint32_t header[WORDS];
    const char *complaint = "cannot be read";
    double *numbers = NULL;
    uint32_t *sampled = NULL;
    FILE *file = fopen(path, "rb");

    if (file == NULL) {
        return complaint;
    }
    if (fread(header, sizeof header, 1, file) == 1) {
        complaint = check(header);
    }
    if (complaint == NULL) {
        const size_t count = count_numbers(header);
        const size_t steps = header[7];

        complaint = "too short";
        numbers = malloc(count * sizeof *numbers);
        sampled = malloc((steps + 1u) * sizeof *sampled);
        if (numbers != NULL && sampled != NULL &&
            fread(numbers, sizeof *numbers, count, file) == count &&
            fread(sampled, sizeof *sampled, steps, file) == steps) {
            complaint = fgetc(file) == EOF ? NULL : "too long";
        }
    }
    (void)fclose(file);
    if (complaint != NULL) {
        free(numbers);
        free(sampled);
        return complaint;
    }
    *scenario = (struct ukf_scenario){
        .n = header[2], .m = header[3], .q = header[4], .r = header[5],
        .inputs = header[6], .steps = header[7], .redraw = header[8] != 0u,
        .interval = numbers[0], .sampled = sampled,
    };
    scenario->x0 = numbers + 1;
    scenario->P0 = scenario->x0 + scenario->n;
    scenario->Q = scenario->P0 + scenario->n * scenario->n;
    scenario->R = scenario->Q + scenario->q * scenario->q;
    scenario->input = scenario->R + scenario->r * scenario->r;
    scenario->measurement = scenario->input + (size_t)scenario->steps * scenario->inputs;
    return NULL;
}

void ukf_scenario_free(struct ukf_scenario *scenario)
{
    /* Both blocks came from malloc; the interval stands before x0. */
    free((double *)(uintptr_t)(scenario->x0 - 1));
    free((uint32_t *)(uintptr_t)scenario->sampled);
    *scenario = (struct ukf_scenario){0};
}

bool ukf_numbers_write(FILE *file, uint32_t count, const ukf_real *values)
{
    for (uint32_t i = 0; i < count; i++) {
        const double value = (double)values[i];

        if (fwrite(&value, sizeof value, 1, file) != 1) {
            return false;
        }
    }
    return true;
}

bool ukf_results_write(FILE *file, uint32_t n, const ukf_real *x, const ukf_real *P,
                       const struct ukf_record *record)
{
    return ukf_numbers_write(file, n, x) && (P == NULL || ukf_numbers_write(file, n * n, P)) &&
           fwrite(record, sizeof *record, 1, file) == 1;
}

#include "scenario_file.h"

#include <stddef.h>
#include <stdlib.h>

/*
 * Little-endian: the words "UKFS", version, n, m, q, r, inputs, steps, redraw, sensors, core_inputs, 0;
 * the doubles interval, x0, P0, Q, R, input, measurement, core_input; the words sampled, terms, variant.
 */
#define MAGIC UINT32_C(0x53464B55)
#define VERSION 2u
#define WORDS 12u
#define MAX_SIZE 32u
#define MAX_STEPS UINT32_C(10000000)

/** Numbers of a file. */
static uint64_t count_numbers(const uint32_t *header)
{
    const uint64_t n = header[2], m = header[3], q = header[4], r = header[5];
    const uint64_t inputs = header[6], steps = header[7], core_inputs = header[10];

    return 1u + n + n * n + q * q + r * r + steps * (inputs + m + core_inputs);
}

/** Words of a file behind the numbers. */
static uint64_t count_words(const uint32_t *header)
{
    const uint64_t steps = header[7], sensors = header[9];

    return steps + sensors + steps * sensors;
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
    if (header[9] > MAX_SIZE) {
        return "sizes must be at most 32";
    }
    return header[7] <= MAX_STEPS && count_numbers(header) <= SIZE_MAX / sizeof(double)
               ? NULL
               : "too many steps";
}

const char *ukf_scenario_read(const char *path, struct ukf_scenario *scenario)
{
    uint32_t header[WORDS];
    const char *complaint = "cannot be read";
    double *numbers = NULL;
    uint32_t *words = NULL;
    FILE *file = fopen(path, "rb");

    if (file == NULL) {
        return complaint;
    }
    if (fread(header, sizeof header, 1, file) == 1) {
        complaint = check(header);
    }
    if (complaint == NULL) {
        const size_t count = (size_t)count_numbers(header);
        const size_t behind = (size_t)count_words(header);

        complaint = "too short";
        numbers = malloc(count * sizeof *numbers);
        words = malloc((behind + 1u) * sizeof *words);
        if (numbers != NULL && words != NULL &&
            fread(numbers, sizeof *numbers, count, file) == count &&
            fread(words, sizeof *words, behind, file) == behind) {
            complaint = fgetc(file) == EOF ? NULL : "too long";
        }
    }
    (void)fclose(file);
    if (complaint != NULL) {
        free(numbers);
        free(words);
        return complaint;
    }
    *scenario = (struct ukf_scenario){
        .n = header[2], .m = header[3], .q = header[4], .r = header[5],
        .inputs = header[6], .steps = header[7], .redraw = header[8] != 0u,
        .interval = numbers[0], .sampled = words, .sensors = header[9], .core_inputs = header[10],
    };
    scenario->x0 = numbers + 1;
    scenario->P0 = scenario->x0 + scenario->n;
    scenario->Q = scenario->P0 + scenario->n * scenario->n;
    scenario->R = scenario->Q + scenario->q * scenario->q;
    scenario->input = scenario->R + scenario->r * scenario->r;
    scenario->measurement = scenario->input + (size_t)scenario->steps * scenario->inputs;
    scenario->core_input = scenario->measurement + (size_t)scenario->steps * scenario->m;
    scenario->terms = scenario->sampled + scenario->steps;
    scenario->variant = scenario->terms + scenario->sensors;
    return NULL;
}

void ukf_scenario_free(struct ukf_scenario *scenario)
{
    /* Both blocks came from malloc; the interval stands before x0, the words begin with sampled. */
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

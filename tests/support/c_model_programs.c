/* Models in C (ukf_sw.lowering.c_models) on points from a file: `program POINTS RESULTS COUNT`. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The type number, and a table of functions with how many numbers each has. */
#include "functions.h"

static number x[ROOM], noise[ROOM], u[ROOM], result[ROOM];

int main(int argc, char **argv)
{
    FILE *points = argc == 4 ? fopen(argv[1], "rb") : NULL;
    FILE *results = argc == 4 ? fopen(argv[2], "wb") : NULL;
    const unsigned long count = argc == 4 ? strtoul(argv[3], NULL, 10) : 0;

    if (points == NULL || results == NULL) {
        return 2;
    }
    for (size_t f = 0; f < sizeof functions / sizeof functions[0]; f++) {
        for (unsigned long point = 0; point < count; point++) {
            if (fread(x, sizeof x[0], functions[f].x, points) != functions[f].x ||
                fread(noise, sizeof x[0], functions[f].noise, points) != functions[f].noise ||
                fread(u, sizeof x[0], functions[f].u, points) != functions[f].u) {
                return 3;
            }
            /* The result may lie where a point was. */
            number *const out = point % 2 != 0 ? x : result;

            functions[f].model(x, noise, u, out);
            if (fwrite(out, sizeof x[0], functions[f].result, results) != functions[f].result) {
                return 4;
            }
        }
    }
    return fclose(results) == 0 ? 0 : 5;
}

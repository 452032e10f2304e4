/* Runs a variant: problem on standard input, estimates on standard output, both binary doubles.
 *
 * In: number of steps, dt, x0 (7), P0 (7 x 7), Q (7 x 7), R (6 x 6), and for each step u (3), z (6).
 * Out: the estimate of each step (7).
 */
#include "baseline.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void take(double *numbers, size_t count)
{
    if (fread(numbers, sizeof *numbers, count, stdin) != count) {
        fputs("The problem is too short\n", stderr);
        exit(2);
    }
}

int main(int argc, char **argv)
{
    const struct filter *const filters[] = {&gsl_filter, &fast_filter, &fast_additive_filter,
                                            &traced_filter, &traced_additive_filter};
    const struct filter *filter = NULL;
    for (size_t i = 0; i < sizeof filters / sizeof *filters; i++)
        if (argc == 2 && !strcmp(argv[1], filters[i]->name))
            filter = filters[i];
    if (filter == NULL) {
        fputs("usage: baseline gsl|fast|fast-additive|traced|traced-additive\n", stderr);
        return 2;
    }
    double steps, dt, x[STATES], P[STATES * STATES], Q[STATES * STATES];
    double R[OBSERVATIONS * OBSERVATIONS];
    take(&steps, 1);
    take(&dt, 1);
    take(x, STATES);
    take(P, STATES * STATES);
    take(Q, STATES * STATES);
    take(R, OBSERVATIONS * OBSERVATIONS);
    filter->initialise(dt, x, P, Q, R);
    for (long k = 0; k < (long)steps; k++) {
        double u[INPUTS], z[OBSERVATIONS];
        take(u, INPUTS);
        take(z, OBSERVATIONS);
        if (filter->iterate(u, z, x)) {
            fprintf(stderr, "Step %ld met a pivot that is not positive\n", k);
            return 1;
        }
        fwrite(x, sizeof *x, STATES, stdout);
    }
    return 0;
}

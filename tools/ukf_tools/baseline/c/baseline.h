/* The nanosatellite's filter wholly in software: what both variants and the program share.
 *
 * State (q1, q2, q3, q0, beta), 7; process noise w, 7; observation noise v, 6; observation 6; input
 * the gyroscope's sample, 3, in rad/s. The models are those of ukf_sw.problems.systems.nanosat.
 */
#ifndef UKF_BASELINE_H
#define UKF_BASELINE_H

enum { STATES = 7, OBSERVATIONS = 6, INPUTS = 3 };

/* What an iteration is doing. On ARM the hint DBG #section marks it: it does nothing, and whoever
 * counts instructions sees it. */
enum section { OUTSIDE = 0, SIG_GEN = 1, PREDICT = 2, UPDATE = 3, MODELS = 4 };
#if defined(__arm__)
#define MARK(section) __asm__ volatile("dbg #%c0" : : "i"(section) : "memory")
#else
#define MARK(section) ((void)(section))
#endif

/* A filter: matrices are row by row; Q and R as ukf_sw.problem has them. */
struct filter {
    const char *name;
    void (*initialise)(double dt, const double x[STATES], const double P[STATES * STATES],
                       const double Q[STATES * STATES],
                       const double R[OBSERVATIONS * OBSERVATIONS]);
    /* One iteration; 0, or 1 if a pivot was not positive. */
    int (*iterate)(const double u[INPUTS], const double z[OBSERVATIONS], double x[STATES]);
};

/* As the papers have it: augmented, dense, GNU Scientific Library, double. */
extern const struct filter gsl_filter;
/* As well as we can: square root, structure used, binary32, vectors of 4. */
extern const struct filter fast_filter;
extern const struct filter fast_additive_filter;
/* The same with models in C as they are traced: scalar, and rounded as in a core. */
extern const struct filter traced_filter;
extern const struct filter traced_additive_filter;

#endif

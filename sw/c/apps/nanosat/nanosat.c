#include "nanosat.h"

#include <stddef.h>

#include "application.h"
#include "ukf_core.h"

_Static_assert(UKF_N == NANOSAT_STATES, "the core must be generated for 7 states");
_Static_assert(UKF_M == NANOSAT_OBSERVATIONS, "the core must be generated for 6 observations");
_Static_assert(UKF_Q == NANOSAT_STATES, "the core must be generated for 7 process noise terms");
_Static_assert(UKF_R == NANOSAT_OBSERVATIONS, "the core must have 6 observation noise terms");
_Static_assert(UKF_SENSORS == 1u || UKF_SENSORS == 9u, "the core must have sensors of 6 or 3 + 3");

/** Observations of the accelerometer; the others are the magnetometer's. */
#define HALF (NANOSAT_OBSERVATIONS / 2u)

bool nanosat_process(void *context, const ukf_real *x, const ukf_real *w, const void *input,
                     ukf_real *next)
{
    const struct nanosat *nanosat = context;
    const ukf_real *u = input;
    const ukf_real dt = nanosat->dt;
    const ukf_real half = dt / 2;
    const ukf_real q1 = x[0], q2 = x[1], q3 = x[2], q0 = x[3];
    const ukf_real r1 = u[0] - x[4], r2 = u[1] - x[5], r3 = u[2] - x[6];

    for (uint32_t i = 0; i < NANOSAT_STATES; i++) {
        next[i] = x[i] + dt * w[i];
    }
    next[0] += half * (q0 * r1 + q2 * r3 - q3 * r2);
    next[1] += half * (q0 * r2 + q3 * r1 - q1 * r3);
    next[2] += half * (q0 * r3 + q1 * r2 - q2 * r1);
    next[3] -= half * (q1 * r1 + q2 * r2 + q3 * r3);
    return true;
}

bool nanosat_observe_gravity(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z)
{
    const ukf_real q1 = x[0], q2 = x[1], q3 = x[2], q0 = x[3];
    const ukf_real s1 = q1 * q1, s2 = q2 * q2, s3 = q3 * q3, s0 = q0 * q0;

    (void)context;
    z[0] = v[0] + 2 * (q0 * q2 + q1 * q3);
    z[1] = v[1] + 2 * (q2 * q3 - q0 * q1);
    z[2] = v[2] + (s0 - s1 - s2 + s3);
    return true;
}

bool nanosat_observe_field(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z)
{
    const ukf_real q1 = x[0], q2 = x[1], q3 = x[2], q0 = x[3];
    const ukf_real s1 = q1 * q1, s2 = q2 * q2, s3 = q3 * q3, s0 = q0 * q0;

    (void)context;
    z[0] = v[0] + (s0 + s1 - s2 - s3);
    z[1] = v[1] + 2 * (q1 * q2 + q0 * q3);
    z[2] = v[2] + 2 * (q1 * q3 - q0 * q2);
    return true;
}

bool nanosat_observe(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z)
{
    return nanosat_observe_gravity(context, x, v, z) &&
           nanosat_observe_field(context, x, v + HALF, z + HALF);
}

const struct ukf_models *ukf_application(const struct ukf_scenario *scenario)
{
    static const struct ukf_sensor both[] = {
        {.observe = nanosat_observe, .terms = NANOSAT_OBSERVATIONS},
    };
    static const struct ukf_sensor each[] = {
        {.observe = nanosat_observe_gravity, .terms = HALF},
        {.observe = nanosat_observe_field, .terms = HALF},
    };
    static struct nanosat nanosat;
    static const struct ukf_models models = {
        .context = &nanosat,
        .process = nanosat_process,
        .sensors = UKF_SENSORS == 1u ? both : each,
    };

    nanosat.dt = (ukf_real)scenario->interval;
    return scenario->inputs == NANOSAT_INPUTS ? &models : NULL;
}

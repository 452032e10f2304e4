#include <stddef.h>

#include "application.h"
#include "sensors.h"
#include "ukf_core.h"

#define DRAG 0.2
#define TURN 6.283185307179586

static bool process(void *context, const ukf_real *x, const ukf_real *w, const void *input,
                    ukf_real *next)
{
    const ukf_real *u = input;
    const ukf_real dt = u[0];
    const ukf_real rate = x[1] + dt * (u[1] - DRAG * x[1] + w[0]);

    (void)context;
    next[0] = x[0] + dt * (x[1] + rate) / 2.0;
    if (next[0] > TURN / 2.0) {
        next[0] -= TURN;
    }
    next[1] = rate;
    return true;
}

const struct ukf_models *ukf_application(const struct ukf_scenario *scenario)
{
    static const struct ukf_sensor sensors[] = {
        {.observe = observe_encoder, .terms = 1u, .angles = 1u << 0},
        {.observe = observe_inertial, .terms = 2u},
    };
    static const struct ukf_models models = {
        .process = process, .sensors = sensors, .state_angles = 1u << 0};

    return scenario->n == 2u && scenario->m == 3u && scenario->inputs == 2u ? &models : NULL;
}

#include "sensors.h"

#include <math.h>

#define RADIUS 0.7
#define GRAVITY 9.81

bool observe_encoder(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z)
{
    (void)context;
    z[0] = x[0] + v[0];
    return true;
}

bool observe_inertial(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z)
{
    const ukf_real outward = RADIUS * (x[1] * x[1]);

    (void)context;
    z[0] = x[1] + v[0];
    z[1] = sqrt(GRAVITY * GRAVITY + outward * outward) + v[1];
    return true;
}

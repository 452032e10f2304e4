#ifndef SENSORS_H
#define SENSORS_H

#include "ukf_filter.h"

bool observe_encoder(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z);
bool observe_inertial(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z);

#endif

/**
 * @file
 * @brief What Python needs to call the filter: values that C has as macros and members.
 */
#include <stddef.h>
#include <stdint.h>

#include "ukf_core.h"
#include "ukf_filter.h"

const struct ukf_core binding_core = UKF_CORE_INITIALISER;
const uint32_t binding_work_length =
    UKF_WORK_LENGTH(UKF_N, UKF_M, UKF_Q, UKF_R, UKF_POINTS, UKF_INPUT_COUNT);
const size_t binding_size = sizeof(struct ukf);
const size_t binding_real_size = sizeof(ukf_real);

void binding_outcome(const struct ukf *ukf, double *nis, uint32_t *gated);
void binding_fault(const struct ukf *ukf, struct ukf_fault *fault);
uint32_t binding_pes(const struct ukf *ukf);
uint32_t binding_doubtful(const struct ukf *ukf);

void binding_outcome(const struct ukf *ukf, double *nis, uint32_t *gated)
{
    *nis = (double)ukf->nis;
    *gated = ukf->gated;
}

void binding_fault(const struct ukf *ukf, struct ukf_fault *fault)
{
    *fault = ukf->driver.fault;
}

uint32_t binding_pes(const struct ukf *ukf)
{
    return ukf->driver.pes;
}

uint32_t binding_doubtful(const struct ukf *ukf)
{
    return ukf->driver.doubtful;
}

#include <stddef.h>

#include "application.h"
#include "ukf_problem.h"

/* The application that is written with a core: `ukf generate` has made its ukf_problem.h. */
const struct ukf_models *ukf_application(const struct ukf_scenario *scenario)
{
    return scenario->inputs == UKF_PROBLEM_INPUTS ? &ukf_problem : NULL;
}

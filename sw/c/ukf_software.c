#include <math.h>
#include <stddef.h>
#include <string.h>

#include "ukf_filter.h"
#include "ukf_internal.h"
#include "ukf_registers.h"

#define TURN 6.283185307179586476925286766559

/** Column k of a matrix. */
static void get_column(const ukf_real *matrix, uint32_t rows, uint32_t columns, uint32_t k,
                       ukf_real *column)
{
    for (uint32_t i = 0; i < rows; i++) {
        column[i] = matrix[i * columns + k];
    }
}

static void put_column(ukf_real *matrix, uint32_t rows, uint32_t columns, uint32_t k,
                       const ukf_real *column)
{
    for (uint32_t i = 0; i < rows; i++) {
        matrix[i * columns + k] = column[i];
    }
}

static enum ukf_result bad_model(struct ukf *ukf, uint32_t point, uint32_t row)
{
    ukf->driver.fault = (struct ukf_fault){.point = point, .index = row};
    return UKF_BAD_MODEL;
}

/** Look at the result of a model for sigma point k; rows that are not used become zero. */
static enum ukf_result check_result(struct ukf *ukf, bool success, ukf_real *values, uint32_t rows,
                                    uint32_t used, uint32_t k)
{
    if (!success) {
        return bad_model(ukf, k, 0u);
    }
    for (uint32_t i = 0; i < rows; i++) {
        if ((used >> i & 1u) == 0u) {
            values[i] = 0;
        } else if (!ukf_is_finite((double)values[i])) {
            return bad_model(ukf, k, i);
        }
    }
    return UKF_OK;
}

/** Angle shifted by whole turns to within half a turn of a reference, in radians. */
static ukf_real wrap(ukf_real angle, ukf_real reference)
{
    return (ukf_real)((double)angle - TURN * rint(((double)angle - (double)reference) / TURN));
}

/** Wrap the rows that are angles to within half a turn of the centre, which stays as it is. */
static void wrap_rows(const struct ukf_core *core, ukf_real *matrix, uint32_t rows, uint32_t angles)
{
    for (uint32_t i = 0; i < rows; i++) {
        ukf_real *row = matrix + i * core->points;
        const ukf_real centre = row[ukf_core_centre(core)];

        for (uint32_t k = ukf_core_first_point(core);
             (angles >> i & 1u) != 0u && k < core->points; k++) {
            row[k] = wrap(row[k], centre);
        }
    }
}

enum ukf_result ukf_software_f(struct ukf *ukf, const void *input)
{
    const struct ukf_core *core = ukf->driver.core;
    const struct ukf_models *models = ukf->models;
    ukf_real x[UKF_MAX_SIZE];
    ukf_real w[UKF_MAX_SIZE];
    ukf_real next[UKF_MAX_SIZE];

    for (uint32_t k = ukf_core_first_point(core); k < core->points; k++) {
        enum ukf_result result;

        get_column(ukf->X, core->n, core->points, k, x);
        get_column(ukf->W, core->q, core->points, k, w);
        result = check_result(ukf, models->process(models->context, x, w, input, next), next,
                              core->n, UKF_ALL, k);
        if (result != UKF_OK) {
            return result;
        }
        put_column(ukf->X, core->n, core->points, k, next);
    }
    wrap_rows(core, ukf->X, core->n, models->state_angles);
    return UKF_OK;
}

/** What is expected of a row of z: its value at the mean; without W0 all weights are equal. */
static ukf_real expected(const struct ukf *ukf, uint32_t row)
{
    const struct ukf_core *core = ukf->driver.core;
    const uint32_t first = ukf_core_first_point(core);
    const ukf_real *points = ukf->Z + row * core->points;
    double sum = 0;

    if (first == 0u) {
        return points[0];
    }
    for (uint32_t k = first; k < core->points; k++) {
        sum += (double)points[k];
    }
    return (ukf_real)(sum / (double)(core->points - first));
}

enum ukf_result ukf_software_h(struct ukf *ukf, uint32_t sensor, uint32_t used, ukf_real *z)
{
    const struct ukf_core *core = ukf->driver.core;
    const struct ukf_models *models = ukf->models;
    const struct ukf_sensor *own = &models->sensors[sensor];
    const struct ukf_range terms = ukf_terms_of(core, models, sensor);
    const uint32_t rows = ukf_core_rows(core, sensor).count;
    const uint32_t angles = own->angles & used;
    ukf_real x[UKF_MAX_SIZE];
    ukf_real v[UKF_MAX_SIZE];
    ukf_real seen[UKF_MAX_SIZE];

    for (uint32_t k = ukf_core_first_point(core); k < core->points; k++) {
        enum ukf_result result;

        get_column(ukf->X, core->n, core->points, k, x);
        get_column(ukf->V + terms.first * core->points, terms.count, core->points, k, v);
        result = check_result(ukf, own->observe(models->context, x, v, seen), seen, rows, used, k);
        if (result != UKF_OK) {
            return result;
        }
        put_column(ukf->Z, rows, core->points, k, seen);
    }
    wrap_rows(core, ukf->Z, rows, angles);
    for (uint32_t i = 0; i < rows; i++) {
        if ((angles >> i & 1u) != 0u) {
            z[i] = wrap(z[i], expected(ukf, i));
        }
    }
    return UKF_OK;
}

/** Whether all numbers are zero in the format of the core. */
static bool all_zero(const struct ukf *ukf, const ukf_real *values, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        if (ukf_driver_round(&ukf->driver, values[i]) != 0) {
            return false;
        }
    }
    return true;
}

enum ukf_result ukf_software_varies(struct ukf *ukf, uint32_t sensor, uint32_t used)
{
    const struct ukf_core *core = ukf->driver.core;
    const struct ukf_range rows = ukf_core_rows(core, sensor);
    const ukf_real *factor = ukf->noise + core->q * core->q;
    const uint32_t number = ukf_core_first_point(core);

    for (uint32_t i = 0; i < rows.count; i++) {
        const ukf_real *row = ukf->Z + i * core->points;
        const ukf_real first = ukf_driver_round(&ukf->driver, row[number]);
        bool varies = (used >> i & 1u) == 0u || first == 0 || !ukf_is_finite((double)first);

        if (core->additive_r != 0u) {
            const uint32_t columns = ukf_core_noise_columns(core);

            varies = varies || !all_zero(ukf, factor + (rows.first + i) * columns, columns);
        }
        for (uint32_t k = number + 1u; !varies && k < core->points; k++) {
            varies = ukf_driver_round(&ukf->driver, row[k]) != first;
        }
        if (!varies) {
            ukf->driver.fault = (struct ukf_fault){
                .step = UKF_STEP_UPDATE,
                .code = UKF_ERROR_CODE_SINGULAR_OBSERVATION,
                .index = rows.first + i,
            };
            return UKF_SINGULAR_OBSERVATION;
        }
    }
    return UKF_OK;
}

#include "ukf_driver.h"

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "ukf_internal.h"
#include "ukf_registers.h"

#define EVENTS (UKF_INTERRUPT_PENDING_DONE_MASK | UKF_INTERRUPT_PENDING_ERROR_MASK)
#define BINARY32_FRACTION 23u
#define BINARY64_FRACTION 52u

/**
 * No bus takes polls faster than this, not even a simulated one with 100 MHz, whose reads take some
 * clocks each; so more of them mean that the clock stands still.
 */
#define POLLS_PER_US 100u
#define FEWEST_POLLS 1000u

/* The results name the errors of the core by their codes. */
_Static_assert((unsigned)UKF_ILLEGAL_STEP == UKF_ERROR_CODE_ILLEGAL_STEP, "code 1");
_Static_assert((unsigned)UKF_NOT_FINITE == UKF_ERROR_CODE_NOT_FINITE, "code 2");
_Static_assert((unsigned)UKF_SINGULAR_OBSERVATION == UKF_ERROR_CODE_SINGULAR_OBSERVATION, "code 3");
_Static_assert((unsigned)UKF_NOT_POSITIVE_DEFINITE == UKF_ERROR_CODE_NOT_POSITIVE_DEFINITE,
               "code 4");
_Static_assert((unsigned)UKF_MODEL_F == UKF_ERROR_CODE_MODEL_F, "code 5");
_Static_assert((unsigned)UKF_MODEL_H == UKF_ERROR_CODE_MODEL_H, "code 6");

const char *ukf_result_name(enum ukf_result result)
{
    static const char *const names[] = {
        [UKF_OK] = "okay",
        [UKF_ILLEGAL_STEP] = "illegal step",
        [UKF_NOT_FINITE] = "not finite",
        [UKF_SINGULAR_OBSERVATION] = "singular observation",
        [UKF_NOT_POSITIVE_DEFINITE] = "not positive definite",
        [UKF_MODEL_F] = "f gives NaN or infinity",
        [UKF_MODEL_H] = "h gives NaN or infinity",
        [UKF_UNKNOWN_ERROR] = "unknown error",
        [UKF_TIMEOUT] = "time-out",
        [UKF_STEP_LOST] = "step lost",
        [UKF_BUS_ERROR] = "bus error",
        [UKF_WRONG_ID] = "wrong ID",
        [UKF_WRONG_SIZES] = "wrong sizes",
        [UKF_WRONG_FORMAT] = "wrong format",
        [UKF_BAD_ARGUMENT] = "bad argument",
        [UKF_BAD_MODEL] = "bad model",
        [UKF_NOT_OPEN] = "not open",
        [UKF_NOT_STARTED] = "not started",
        [UKF_NOT_RECOVERED] = "not recovered",
        [UKF_ESTIMATE_LOST] = "estimate lost",
    };

    if ((size_t)result >= sizeof names / sizeof names[0]) {
        return "not a result";
    }
    return names[result] != NULL ? names[result] : "unknown error";
}

/* Doubt. It arises where a write or a step fails, and ends in ukf_driver_recover() and _begin(). */

enum ukf_result ukf_driver_check(const struct ukf_driver *driver)
{
    if (!driver->open) {
        return UKF_NOT_OPEN;
    }
    return driver->doubtful ? UKF_NOT_RECOVERED : UKF_OK;
}

bool ukf_is_refusal(enum ukf_result result)
{
    return result == UKF_NOT_FINITE || result == UKF_SINGULAR_OBSERVATION ||
           result == UKF_NOT_POSITIVE_DEFINITE || result == UKF_MODEL_F || result == UKF_MODEL_H;
}

enum ukf_result ukf_driver_judged(struct ukf_driver *driver, enum ukf_result result)
{
    driver->doubtful = driver->doubtful || !(result == UKF_OK || ukf_is_refusal(result));
    return result;
}

/* Sigma points. */

uint32_t ukf_core_first_point(const struct ukf_core *core)
{
    return core->w0_low == 0u && core->w0_high == 0u ? 1u : 0u;
}

uint32_t ukf_core_centre(const struct ukf_core *core)
{
    return ukf_core_first_point(core) == 0u ? 0u : core->points - 1u;
}

/* Sensors. */

/** As many of the lowest bits as there are rows. */
static uint32_t bits_of_rows(uint32_t rows)
{
    return rows < UKF_MAX_SIZE ? (UINT32_C(1) << rows) - 1u : UINT32_MAX;
}

uint32_t ukf_core_sensors(const struct ukf_core *core)
{
    uint32_t count = 0;

    for (uint32_t i = 0; i < UKF_MAX_SIZE; i++) {
        count += core->sensors >> i & 1u;
    }
    return count;
}

struct ukf_range ukf_core_rows(const struct ukf_core *core, uint32_t sensor)
{
    struct ukf_range rows = {.first = 0u, .count = 0u};
    uint32_t begun = 0;

    for (uint32_t i = 0; i < core->m; i++) {
        begun += core->sensors >> i & 1u;
        if (begun == sensor + 1u) {
            rows.first = rows.count == 0u ? i : rows.first;
            rows.count++;
        }
    }
    return rows;
}

uint32_t ukf_core_noise_columns(const struct ukf_core *core)
{
    uint32_t columns = 0;

    if (core->additive_r == 0u || core->r == 0u) {
        return core->r;
    }
    for (uint32_t sensor = 0; sensor < ukf_core_sensors(core); sensor++) {
        const uint32_t rows = ukf_core_rows(core, sensor).count;

        columns = rows > columns ? rows : columns;
    }
    return columns;
}

/* Accesses. */

static enum ukf_result refused(struct ukf_driver *driver, uint32_t address)
{
    driver->fault = (struct ukf_fault){.address = address};
    return UKF_BUS_ERROR;
}

static enum ukf_result get(struct ukf_driver *driver, uint32_t address, uint32_t *word)
{
    const struct ukf_port *port = driver->port;
    const enum ukf_result result = ukf_driver_check(driver);

    if (result != UKF_OK) {
        return result;
    }
    return port->read(port->context, address, word) ? UKF_OK : refused(driver, address);
}

static enum ukf_result put(struct ukf_driver *driver, uint32_t address, uint32_t word)
{
    const struct ukf_port *port = driver->port;
    const enum ukf_result result = ukf_driver_check(driver);

    if (result != UKF_OK) {
        return result;
    }
    return port->write(port->context, address, word) ? UKF_OK
                                                     : ukf_driver_judged(driver, refused(driver, address));
}

/* Numbers and words. Subnormal numbers are zeros of their sign, and there is one NaN. */

static uint32_t to_binary32(double value)
{
    const uint32_t sign = signbit(value) ? UINT32_C(0x80000000) : 0u;
    uint32_t word;
    float narrow;

    if (!ukf_is_number(value)) {
        return UINT32_C(0x7FC00000);
    }
    /* What is below the smallest normal number after rounding to 24 bits, exponent unbounded. */
    if (fabs(value) < 0x1p-126 - 0x1p-151) {
        return sign;
    }
    narrow = (float)value;
    memcpy(&word, &narrow, sizeof word);
    return word;
}

static double from_binary32(uint32_t word)
{
    float narrow;

    if ((word & UINT32_C(0x7F800000)) == 0u) {
        word &= UINT32_C(0x80000000);
    }
    memcpy(&narrow, &word, sizeof narrow);
    return (double)narrow;
}

static uint64_t to_binary64(double value)
{
    uint64_t word;

    if (!ukf_is_number(value)) {
        return UINT64_C(0x7FF8000000000000);
    }
    memcpy(&word, &value, sizeof word);
    return (word & UINT64_C(0x7FF0000000000000)) == 0u ? word & UINT64_C(0x8000000000000000) : word;
}

static double from_binary64(uint64_t word)
{
    double value;

    if ((word & UINT64_C(0x7FF0000000000000)) == 0u) {
        word &= UINT64_C(0x8000000000000000);
    }
    memcpy(&value, &word, sizeof value);
    return value;
}

static bool is_double(const struct ukf_driver *driver)
{
    return driver->core->fraction_bits == BINARY64_FRACTION;
}

/** The word of a number, of 32 or 64 bits. */
static uint64_t to_word(const struct ukf_driver *driver, ukf_real value)
{
    return is_double(driver) ? to_binary64((double)value) : to_binary32((double)value);
}

ukf_real ukf_driver_round(const struct ukf_driver *driver, ukf_real value)
{
    return (ukf_real)(is_double(driver) ? from_binary64(to_binary64((double)value))
                                        : from_binary32(to_binary32((double)value)));
}

/** Read a number; one of 64 bits has its lower word first. */
static enum ukf_result get_number(struct ukf_driver *driver, uint32_t address, ukf_real *value)
{
    enum ukf_result result;
    uint32_t low;
    uint32_t high;

    result = get(driver, address, &low);
    if (result != UKF_OK) {
        return result;
    }
    if (!is_double(driver)) {
        *value = (ukf_real)from_binary32(low);
        return UKF_OK;
    }
    result = get(driver, address + 4u, &high);
    if (result == UKF_OK) {
        *value = (ukf_real)from_binary64((uint64_t)high << 32 | low);
    }
    return result;
}

static enum ukf_result put_number(struct ukf_driver *driver, uint32_t address, ukf_real value)
{
    const uint64_t word = to_word(driver, value);
    const enum ukf_result result = put(driver, address, (uint32_t)word);

    return result == UKF_OK && is_double(driver) ? put(driver, address + 4u, (uint32_t)(word >> 32))
                                                 : result;
}

enum ukf_result ukf_driver_read(struct ukf_driver *driver, uint32_t base, uint32_t rows,
                                uint32_t columns, uint32_t stride, ukf_real *values)
{
    for (uint32_t i = 0; i < rows; i++) {
        for (uint32_t j = 0; j < columns; j++) {
            const uint32_t address =
                base + i * driver->core->row_stride + j * driver->core->element_bytes;
            const enum ukf_result result = get_number(driver, address, &values[i * stride + j]);

            if (result != UKF_OK) {
                return result;
            }
        }
    }
    return UKF_OK;
}

/** Forget what the core no longer has once a region is written. */
static void forget(struct ukf_driver *driver, uint32_t base)
{
    const struct ukf_core *core = driver->core;
    const bool noise =
        base == core->process_noise_factor || base == core->observation_noise_factor;

    if (base == core->state) {
        driver->x_known = false;
    }
    if (base == core->factor) {
        driver->predicted = false; /* L replaces the covariance of a prediction */
    }
    if (noise) {
        driver->initialised = false;
    }
    if (noise || base == core->state || base == core->factor) {
        driver->drawn = false;
        driver->propagated = false;
    }
}

enum ukf_result ukf_driver_write(struct ukf_driver *driver, uint32_t base, uint32_t rows,
                                 uint32_t columns, uint32_t stride, const ukf_real *values)
{
    enum ukf_result result = ukf_driver_check(driver);

    if (result != UKF_OK) {
        return result;
    }
    forget(driver, base);
    for (uint32_t i = 0; i < rows; i++) {
        for (uint32_t j = 0; j < columns; j++) {
            const uint32_t address =
                base + i * driver->core->row_stride + j * driver->core->element_bytes;

            result = put_number(driver, address, values[i * stride + j]);
            if (result != UKF_OK) {
                return result;
            }
        }
    }
    return UKF_OK;
}

bool ukf_driver_same(const struct ukf_driver *driver, ukf_real value, ukf_real other)
{
    return to_word(driver, value) == to_word(driver, other);
}

static bool same_words(const struct ukf_driver *driver, const ukf_real *values,
                       const ukf_real *others, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        if (!ukf_driver_same(driver, values[i], others[i])) {
            return false;
        }
    }
    return true;
}

enum ukf_result ukf_driver_rewrite(struct ukf_driver *driver, uint32_t base, uint32_t rows,
                                   uint32_t columns, const ukf_real *values,
                                   const ukf_real *before)
{
    /* Of no rows: what writing to the region does, also if nothing is left to write. */
    enum ukf_result result = ukf_driver_write(driver, base, 0u, columns, columns, values);

    for (uint32_t i = 0; result == UKF_OK && i < rows; i++) {
        const uint32_t place = i * columns;

        if (before == NULL || !same_words(driver, &values[place], &before[place], columns)) {
            result = ukf_driver_write(driver, base + i * driver->core->row_stride, 1u, columns,
                                      columns, &values[place]);
        }
    }
    return result;
}

/* What the core is. */

static bool in_range(uint32_t value, uint32_t least, uint32_t most)
{
    return least <= value && value <= most;
}

static bool is_supported(const struct ukf_core *core)
{
    const bool single = core->exponent_bits == 8u && core->fraction_bits == BINARY32_FRACTION &&
                        core->element_bytes == 4u;
    const bool twice = core->exponent_bits == 11u && core->fraction_bits == BINARY64_FRACTION &&
                       core->element_bytes == 8u;
    const uint32_t length = core->n + (core->additive_q ? 0u : core->q) +
                            (core->additive_r ? 0u : core->r);

    return (single || twice) && in_range(core->n, 1u, UKF_MAX_SIZE) &&
           in_range(core->m, 1u, UKF_MAX_SIZE) && core->q <= UKF_MAX_SIZE &&
           core->r <= UKF_MAX_SIZE && core->points == length + 2u &&
           (core->additive_r == 0u || core->r == 0u || core->r == core->m) &&
           (core->sensors & 1u) != 0u && (core->sensors & ~bits_of_rows(core->m)) == 0u &&
           core->inputs_of_f <= core->input_count && core->inputs_of_h <= core->input_count;
}

/** A field that the core must have. */
struct field {
    uint32_t offset;
    uint32_t mask;
    uint32_t shift;
    uint32_t value;
    enum ukf_result error;
};

#define FIELD(name, item, value, error) \
    {UKF_##name##_OFFSET, UKF_##name##_##item##_MASK, UKF_##name##_##item##_SHIFT, value, error}
#define MEMBER(name, item, member) FIELD(name, item, core->member, WRONG_##name),
#define WRONG_SIZES UKF_WRONG_SIZES
#define WRONG_CONFIG UKF_WRONG_FORMAT
#define WRONG_W0_LOW UKF_WRONG_FORMAT
#define WRONG_W0_HIGH UKF_WRONG_FORMAT
#define WRONG_SENSORS UKF_WRONG_SIZES
#define WRONG_MODELS UKF_WRONG_FORMAT

static enum ukf_result check_core(struct ukf_driver *driver)
{
    const struct ukf_core *core = driver->core;
    const struct field fields[] = {
        FIELD(ID, MAGIC, UKF_ID_MAGIC_VALUE, UKF_WRONG_ID),
        FIELD(ID, VERSION, UKF_ID_VERSION_VALUE, UKF_WRONG_ID),
        UKF_IDENTITY(MEMBER)
    };
    uint32_t word = 0;

    for (size_t i = 0; i < sizeof fields / sizeof fields[0]; i++) {
        const struct field *field = &fields[i];
        uint32_t found;

        if (i == 0 || fields[i - 1].offset != field->offset) {
            const enum ukf_result result = get(driver, field->offset, &word);

            if (result != UKF_OK) {
                return result;
            }
        }
        if (field->offset == UKF_CONFIG_OFFSET) {
            driver->pes = (word & UKF_CONFIG_PES_MASK) >> UKF_CONFIG_PES_SHIFT;
        }
        found = (word & field->mask) >> field->shift;
        if (found != field->value) {
            driver->fault = (struct ukf_fault){
                .address = field->offset, .expected = field->value, .found = found};
            return field->error;
        }
    }
    return UKF_OK;
}

enum ukf_result ukf_driver_open(struct ukf_driver *driver, const struct ukf_core *core,
                                const struct ukf_port *port, uint32_t timeout_us)
{
    enum ukf_result result;

    *driver = (struct ukf_driver){.core = core, .port = port, .timeout_us = timeout_us};
    if (core == NULL || port == NULL || port->read == NULL || port->write == NULL ||
        port->now_us == NULL || timeout_us == 0u || !is_supported(core)) {
        return UKF_BAD_ARGUMENT;
    }
    driver->open = true;
    result = check_core(driver);
    if (result == UKF_OK) {
        result = ukf_driver_begin(driver);
    }
    driver->open = result == UKF_OK;
    return result;
}

/* Steps. */

static enum ukf_result enable_interrupts(struct ukf_driver *driver)
{
    return put(driver, UKF_INTERRUPT_ENABLE_OFFSET, driver->port->wait != NULL ? EVENTS : 0u);
}

/** Reset and enable the core: a running step is dropped, x and the factors stay. */
static enum ukf_result reset(struct ukf_driver *driver)
{
    enum ukf_result result;

    driver->initialised = false;
    driver->drawn = false;
    driver->propagated = false;
    driver->mask_known = false;
    driver->x_known = false;
    result = put(driver, UKF_CONTROL_OFFSET, UKF_CONTROL_ENABLE_MASK | UKF_CONTROL_RESET_MASK);
    if (result == UKF_OK) {
        result = put(driver, UKF_INTERRUPT_PENDING_OFFSET, EVENTS);
    }
    return result == UKF_OK ? enable_interrupts(driver) : result;
}

enum ukf_result ukf_driver_begin(struct ukf_driver *driver)
{
    driver->doubtful = false;
    driver->dropping = false;
    driver->predicted = false;
    driver->step = UKF_STEP_IDLE;
    return reset(driver);
}

/** Wait until no step runs, or for the time-out; `status` is the last STATUS. */
static enum ukf_result wait_for(struct ukf_driver *driver, bool interrupts, uint32_t *status)
{
    const struct ukf_port *port = driver->port;
    const uint64_t deadline = port->now_us(port->context) + driver->timeout_us;
    uint64_t polls = (uint64_t)driver->timeout_us * POLLS_PER_US;

    polls = polls > FEWEST_POLLS ? polls : FEWEST_POLLS;
    for (;;) {
        enum ukf_result result;
        bool late = false;

        if (interrupts) {
            const uint64_t now = port->now_us(port->context);

            late = !port->wait(port->context, now < deadline ? (uint32_t)(deadline - now) : 0u);
            result = put(driver, UKF_INTERRUPT_PENDING_OFFSET, EVENTS);
            if (result != UKF_OK) {
                return result;
            }
        }
        polls--;
        /* The clock is read first: a step that ends while we look is not late. */
        late = port->now_us(port->context) > deadline || polls == 0u || late;
        result = get(driver, UKF_STATUS_OFFSET, status);
        if (result != UKF_OK || late || (*status & UKF_STATUS_STATE_MASK) == 0u) {
            return result;
        }
    }
}

/** Start bit and done bit of a step. */
static uint32_t bit_of(uint32_t step)
{
    _Static_assert(UKF_CONTROL_INIT_MASK == UKF_STATUS_INIT_MASK, "start and done bits");
    _Static_assert(UKF_CONTROL_ITERATE_MASK == UKF_STATUS_ITERATE_MASK, "start and done bits");
    _Static_assert(UKF_CONTROL_ITERATE_MASK ==
                       UKF_CONTROL_INIT_MASK << (UKF_STEP_ITERATE - UKF_STEP_INIT),
                   "bits in the order of the steps");
    return UKF_CONTROL_INIT_MASK << (step - UKF_STEP_INIT);
}

/** Start a step and see how it ends: STATUS, and ERROR.CODE as a result. */
static enum ukf_result start_and_wait(struct ukf_driver *driver, uint32_t step, uint32_t sensor,
                                      uint32_t variant, uint32_t *status)
{
    enum ukf_result result;
    uint32_t error;
    uint32_t code;

    result = put(driver, UKF_CONTROL_OFFSET, UKF_CONTROL_ENABLE_MASK | bit_of(step) |
                                                 sensor << UKF_CONTROL_SENSOR_SHIFT |
                                                 variant << UKF_CONTROL_VARIANT_SHIFT);
    if (result == UKF_OK) {
        result = wait_for(driver, driver->port->wait != NULL, status);
    }
    if (result == UKF_OK && (*status & UKF_STATUS_STATE_MASK) != 0u) {
        driver->fault = (struct ukf_fault){
            .step = step,
            .state = (*status & UKF_STATUS_STATE_MASK) >> UKF_STATUS_STATE_SHIFT,
        };
        return UKF_TIMEOUT;
    }
    if (result == UKF_OK) {
        result = get(driver, UKF_ERROR_OFFSET, &error);
    }
    if (result != UKF_OK) {
        return result;
    }
    code = (error & UKF_ERROR_CODE_MASK) >> UKF_ERROR_CODE_SHIFT;
    if (code == UKF_ERROR_CODE_NONE && (*status & bit_of(step)) != 0u) {
        return UKF_OK;
    }
    driver->fault = (struct ukf_fault){
        .step = step,
        .code = code,
        .index = (error & UKF_ERROR_INDEX_MASK) >> UKF_ERROR_INDEX_SHIFT,
    };
    if (code == UKF_ERROR_CODE_NONE) {
        return UKF_STEP_LOST;
    }
    return code < UKF_FIRST_OWN_RESULT ? (enum ukf_result)code : UKF_UNKNOWN_ERROR;
}

/** Run a step, with a variant of a sensor's model. */
static enum ukf_result run_of(struct ukf_driver *driver, uint32_t step, uint32_t sensor,
                              uint32_t variant, uint32_t *status)
{
    const bool propagated = driver->propagated;
    enum ukf_result result = ukf_driver_check(driver);

    if (result != UKF_OK) {
        return result;
    }
    driver->step = step;
    driver->drawn = false;
    driver->propagated = false;
    result = ukf_driver_judged(driver, start_and_wait(driver, step, sensor, variant, status));
    if (result == UKF_OK) {
        driver->drawn = (*status & UKF_STATUS_POINTS_MASK) != 0u;
        driver->propagated = step == UKF_STEP_PREDICT || step == UKF_STEP_F ||
                             (propagated && step == UKF_STEP_COVARIANCE);
    }
    /* A step that is illegal has not begun; but PREDICT has its points overwritten before. */
    if (!driver->doubtful || (result == UKF_ILLEGAL_STEP && step != UKF_STEP_PREDICT &&
                              step != UKF_STEP_ITERATE)) {
        driver->step = UKF_STEP_IDLE;
    }
    return result;
}

enum ukf_result ukf_driver_run(struct ukf_driver *driver, uint32_t step, uint32_t *status)
{
    return run_of(driver, step, 0u, 0u, status);
}

enum ukf_result ukf_driver_correct(struct ukf_driver *driver, uint32_t step, uint32_t sensor,
                                   uint32_t variant, ukf_real *nis, bool *gated)
{
    const bool known = driver->x_known;
    enum ukf_result result;
    uint32_t status;

    driver->x_known = false;
    result = run_of(driver, step, sensor, variant, &status);
    if (result != UKF_OK) {
        return result;
    }
    *gated = (status & UKF_STATUS_GATED_MASK) != 0u;
    driver->x_known = known && *gated;
    driver->predicted = driver->predicted && *gated;
    /* NIS_HIGH follows NIS_LOW as the upper word of a number follows the lower one. */
    _Static_assert(UKF_NIS_HIGH_OFFSET == UKF_NIS_LOW_OFFSET + 4u, "NIS is one number");
    return ukf_driver_judged(driver, get_number(driver, UKF_NIS_LOW_OFFSET, nis));
}

enum ukf_result ukf_driver_status(struct ukf_driver *driver, uint32_t *status)
{
    return ukf_driver_judged(driver, get(driver, UKF_STATUS_OFFSET, status));
}

enum ukf_result ukf_driver_initialise(struct ukf_driver *driver)
{
    enum ukf_result result = UKF_OK;
    uint32_t status;

    if (!driver->initialised) {
        result = ukf_driver_run(driver, UKF_STEP_INIT, &status);
        driver->initialised = result == UKF_OK;
    }
    return result;
}

enum ukf_result ukf_driver_generate(struct ukf_driver *driver)
{
    enum ukf_result result;
    uint32_t status;

    result = ukf_driver_initialise(driver);
    if (result == UKF_OK) {
        result = ukf_driver_run(driver, UKF_STEP_SIG_GEN, &status);
    }
    driver->predicted = driver->predicted && result != UKF_OK;
    return result;
}

enum ukf_result ukf_driver_state(struct ukf_driver *driver, ukf_real *x)
{
    const struct ukf_core *core = driver->core;
    enum ukf_result result = ukf_driver_check(driver);

    if (result == UKF_OK && !driver->x_known) {
        result = ukf_driver_read(driver, core->state, 1u, core->n, core->n, driver->x);
        driver->x_known = result == UKF_OK;
    }
    if (result == UKF_OK) {
        memcpy(x, driver->x, core->n * sizeof *x);
    }
    return result;
}

enum ukf_result ukf_driver_points(struct ukf_driver *driver, ukf_real *points)
{
    const struct ukf_core *core = driver->core;
    const uint32_t first = ukf_core_first_point(core);
    const uint32_t drawn = core->n + 2u;
    ukf_real x[UKF_MAX_SIZE];
    enum ukf_result result =
        ukf_driver_read(driver, core->state_points + first * core->element_bytes, core->n,
                        drawn - first, core->points, points + first);

    if (result == UKF_OK && first == 0u) {
        for (uint32_t i = 0; i < core->n; i++) {
            driver->x[i] = points[i * core->points];
        }
        driver->x_known = true;
    }
    if (result == UKF_OK) {
        result = ukf_driver_state(driver, x);
    }
    for (uint32_t i = 0; result == UKF_OK && i < core->n; i++) {
        for (uint32_t k = drawn; k < core->points; k++) {
            points[i * core->points + k] = x[i];
        }
    }
    return result;
}

/** Write the sigma points of some rows of a region. */
static enum ukf_result put_points(struct ukf_driver *driver, uint32_t base, uint32_t rows,
                                  const ukf_real *points)
{
    const struct ukf_core *core = driver->core;
    const uint32_t first = ukf_core_first_point(core);

    return ukf_driver_write(driver, base + first * core->element_bytes, rows, core->points - first,
                            core->points, points + first);
}

enum ukf_result ukf_driver_predict(struct ukf_driver *driver, ukf_real *points)
{
    const struct ukf_core *core = driver->core;
    ukf_real x[UKF_MAX_SIZE];
    enum ukf_result result = ukf_driver_state(driver, x);
    uint32_t status;

    if (result != UKF_OK) {
        return result;
    }
    driver->step = UKF_STEP_PREDICT; /* its points are about to be overwritten */
    driver->x_known = false;
    if (!driver->predicted) {
        driver->predicted = true;
        memcpy(driver->before, x, core->n * sizeof *x);
    }
    result = put_points(driver, core->state_points, core->n, points);
    if (result == UKF_OK) {
        result = ukf_driver_run(driver, UKF_STEP_PREDICT, &status);
    }
    if (ukf_is_refusal(result)) {
        driver->predicted = false;
    }
    for (uint32_t i = 0; result == UKF_OK && i < core->n; i++) {
        ukf_real *row = points + i * core->points;

        for (uint32_t k = ukf_core_first_point(core); k < core->points; k++) {
            row[k] = ukf_driver_round(driver, row[k]);
        }
    }
    return result;
}

enum ukf_result ukf_driver_mask(struct ukf_driver *driver, struct ukf_range rows, uint32_t mask)
{
    const uint32_t before = driver->mask_known ? driver->mask : bits_of_rows(driver->core->m);
    const uint32_t own = bits_of_rows(rows.count);
    const uint32_t bits = (before & ~(own << rows.first)) | (mask & own) << rows.first;
    enum ukf_result result = UKF_OK;

    if (!driver->mask_known || bits != before) {
        result = put(driver, UKF_MASK_OFFSET, bits);
        driver->mask = bits;
        driver->mask_known = result == UKF_OK;
    }
    return result;
}

enum ukf_result ukf_driver_update(struct ukf_driver *driver, uint32_t sensor,
                                  const ukf_real *points, const ukf_real *z, uint32_t mask,
                                  ukf_real *nis, bool *gated)
{
    enum ukf_result result = ukf_driver_check(driver);
    const struct ukf_core *core = driver->core;
    struct ukf_range rows;
    uint32_t offset;

    if (result != UKF_OK) {
        return result;
    }
    rows = ukf_core_rows(core, sensor);
    if (rows.count == 0u) {
        return UKF_BAD_ARGUMENT;
    }
    offset = rows.first * core->row_stride;
    result = ukf_driver_initialise(driver);
    if (result == UKF_OK) {
        result = put_points(driver, core->observation_points + offset, rows.count, points);
    }
    if (result == UKF_OK) {
        result = ukf_driver_write(driver, core->observation + offset, rows.count, 1u, 1u, z);
    }
    if (result == UKF_OK) {
        result = ukf_driver_mask(driver, rows, mask);
    }
    return result == UKF_OK
               ? ukf_driver_correct(driver, UKF_STEP_UPDATE, sensor, 0u, nis, gated)
               : result;
}

enum ukf_result ukf_driver_covariance(struct ukf_driver *driver, ukf_real *P)
{
    const struct ukf_core *core = driver->core;
    enum ukf_result result;
    uint32_t status;

    result = ukf_driver_initialise(driver);
    if (result == UKF_OK) {
        result = ukf_driver_run(driver, UKF_STEP_COVARIANCE, &status);
    }
    for (uint32_t i = 0; result == UKF_OK && i < core->n; i++) {
        result = ukf_driver_read(driver, core->covariance + i * core->row_stride, 1u, i + 1u,
                                 core->n, &P[i * core->n]);
        for (uint32_t j = 0; j < i; j++) {
            P[j * core->n + i] = P[i * core->n + j];
        }
    }
    return result;
}

enum ukf_result ukf_driver_gate(struct ukf_driver *driver, ukf_real gate)
{
    _Static_assert(UKF_GATE_HIGH_OFFSET == UKF_GATE_LOW_OFFSET + 4u, "the gate is one number");
    const ukf_real largest = is_double(driver) ? (ukf_real)DBL_MAX : (ukf_real)FLT_MAX;
    const bool overflows = ukf_is_finite((double)gate) && gate > largest;

    return put_number(driver, UKF_GATE_LOW_OFFSET, overflows ? largest : gate);
}

enum ukf_result ukf_driver_cycles(struct ukf_driver *driver, uint32_t *cycles)
{
    return get(driver, UKF_CYCLES_OFFSET, cycles);
}

/* After an error. */

/** Reset the core. What is left then is an estimate whose factor it has. */
static enum ukf_result restart(struct ukf_driver *driver)
{
    const struct ukf_core *core = driver->core;
    enum ukf_result result = reset(driver);

    if (result == UKF_OK && driver->predicted) {
        result = ukf_driver_write(driver, core->state, 1u, core->n, core->n, driver->before);
    }
    if (result == UKF_OK) {
        driver->predicted = false;
    }
    return result;
}

/** Let a running step end, or drop it; gives STATUS. */
static enum ukf_result come_to_rest(struct ukf_driver *driver, uint32_t *status)
{
    enum ukf_result result = wait_for(driver, false, status);

    if (result != UKF_OK || (*status & UKF_STATUS_STATE_MASK) == 0u) {
        return result;
    }
    /* An event from now on is the end of the step; a handler of interrupts must not clear it. */
    result = put(driver, UKF_INTERRUPT_ENABLE_OFFSET, 0u);
    if (result == UKF_OK) {
        result = put(driver, UKF_INTERRUPT_PENDING_OFFSET, EVENTS);
    }
    if (result == UKF_OK) {
        result = get(driver, UKF_STATUS_OFFSET, status);
    }
    if (result == UKF_OK && (*status & UKF_STATUS_STATE_MASK) != 0u) {
        driver->dropping = true;
        result = put(driver, UKF_CONTROL_OFFSET, UKF_CONTROL_ENABLE_MASK | UKF_CONTROL_RESET_MASK);
    }
    return result == UKF_OK ? get(driver, UKF_STATUS_OFFSET, status) : result;
}

/** Whether a step that could have factorised a prediction is known not to have. */
static enum ukf_result find_factor(struct ukf_driver *driver)
{
    uint32_t events = EVENTS;
    enum ukf_result result = UKF_OK;

    if (driver->step != UKF_STEP_SIG_GEN && driver->step != UKF_STEP_UPDATE &&
        driver->step != UKF_STEP_H && driver->step != UKF_STEP_ITERATE) {
        return UKF_OK;
    }
    if (driver->dropping) {
        result = get(driver, UKF_INTERRUPT_PENDING_OFFSET, &events);
    }
    return result == UKF_OK && (events & EVENTS) != 0u ? UKF_ESTIMATE_LOST : result;
}

/** Get the core into a state that is known. */
static enum ukf_result find_out(struct ukf_driver *driver)
{
    const bool predicted = driver->predicted && driver->step != UKF_STEP_PREDICT &&
                           driver->step != UKF_STEP_F;
    uint32_t status;
    enum ukf_result result = come_to_rest(driver, &status);

    driver->drawn = false;
    driver->propagated = false;
    if (result == UKF_OK && predicted && (status & UKF_STATUS_INITIALISED_MASK) != 0u) {
        /* The core has not been reset, so its flags are true. */
        const bool drawn = (status & UKF_STATUS_POINTS_MASK) != 0u;
        const bool failed = driver->step == UKF_STEP_ITERATE && /* in f or PREDICT */
                            (status & UKF_STATUS_RESIDUALS_MASK) == 0u;

        if (!drawn && !failed) {
            driver->initialised = true;
            return enable_interrupts(driver);
        }
        driver->predicted = driver->predicted && !drawn;
    } else if (result == UKF_OK && predicted) {
        result = find_factor(driver);
    }
    return result == UKF_OK ? restart(driver) : result;
}

enum ukf_result ukf_driver_recover(struct ukf_driver *driver)
{
    enum ukf_result result = driver->open ? UKF_OK : UKF_NOT_OPEN;

    if (result == UKF_OK) {
        driver->doubtful = false;
        result = find_out(driver);
        driver->doubtful = result != UKF_OK;
    }
    if (result == UKF_OK) {
        driver->step = UKF_STEP_IDLE;
        driver->dropping = false;
    }
    return result;
}

enum ukf_result ukf_driver_undo_predict(struct ukf_driver *driver)
{
    return driver->predicted ? restart(driver) : UKF_OK;
}

#include "parts.h"
#include <math.h>
#include <stdio.h>
#include <string.h>

/* Points later than all before that a solver may try within a step; methods of high order try some tens. */
#define MOST_TRIALS 1000

/* ---- Evaluation ---- */

void instance_update_point(Instance *instance)
{
    const bool clamp = instance->now.policy == POLICY_CLAMP;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        const double value = instance->now.columns[i];
        instance->point[i] = clamp && i < INPUT_COUNT ? clamped(&model_columns[i], value) : value;
    }
}

/* Returns Discard where a solver may try again with a smaller step. FMI 2.0 has it for reading variables in model exchange only. */
static Status not_computable(const Instance *instance)
{
    const bool discards = instance->fmi_version == 3 || instance->interface == MODEL_EXCHANGE;
    return discards ? STATUS_DISCARD : STATUS_ERROR;
}

/* Checks that all values are finite, and otherwise reports it with the given status. */
static Status check_computed(Instance *instance, const double values[], size_t count, Status refused)
{
    for (size_t i = 0; i < count; i++) {
        if (!is_finite(values[i])) {
            return instance_tell(instance, refused,
                                 "the equations have no finite solution in this state: a formula is not defined there, a "
                                 "mass matrix is not positive definite, or a value is too large");
        }
    }
    return STATUS_OK;
}

Status instance_check_derivatives(Instance *instance, const double values[], size_t count)
{
    /* FMI 2.0 has no Discard for derivatives */
    return check_computed(instance, values, count, instance->fmi_version == 2 ? STATUS_ERROR : STATUS_DISCARD);
}

Status instance_update_results(Instance *instance)
{
    if (!instance->stale) {
        return STATUS_OK;
    }
    instance_update_point(instance);
    model_evaluate(&instance->scratch, instance->point, instance->results);
    const Status status = check_computed(instance, instance->results, RESULT_COUNT, not_computable(instance));
    instance->stale = status != STATUS_OK;
    return status;
}

/* ---- Continuous states ---- */

#if MODEL_GOES_ON
/* Swaps the inputs that the host has set and those of the point. */
static void swap_inputs(Instance *instance)
{
    for (size_t i = 0; i < INPUT_COUNT; i++) {
        if (model_columns[i].role == ROLE_INPUT) {
            const double value = instance->now.columns[i];
            instance->now.columns[i] = instance->point[i];
            instance->point[i] = value;
        }
    }
}

static void start_states(Instance *instance)
{
    /* inputs that act directly are clamped */
    instance_update_point(instance);
    swap_inputs(instance);
    model_start(instance->now.columns);
    swap_inputs(instance);
}
#endif

void instance_initialize_states(Instance *instance)
{
#if MODEL_GOES_ON
    if (is_starting(instance)) {
        start_states(instance);
    }
#else
    (void)instance;
#endif
}

void instance_restart(Instance *instance, size_t column)
{
#if MODEL_HAS_STATES
    size_t state = INPUT_COUNT;
    for (size_t i = 0; i < column; i++) {
        state += model_columns[i].role == ROLE_START ? 1 : 0;
    }
    if (model_columns[column].role == ROLE_START) {
        instance->now.columns[state] = instance->now.columns[column];
    }
#elif MODEL_GOES_ON
    (void)column;
    start_states(instance);
#else
    (void)instance;
    (void)column;
#endif
}

void instance_get_states(const Instance *instance, double states[])
{
    for (size_t i = INPUT_COUNT; i < NAMED_COUNT; i++) {
        states[i - INPUT_COUNT] = instance->now.columns[i];
    }
}

void instance_get_nominals(double nominals[])
{
    for (size_t i = INPUT_COUNT; i < NAMED_COUNT; i++) {
        nominals[i - INPUT_COUNT] = model_columns[i].nominal;
    }
}

Status instance_get_derivatives(Instance *instance, double derivatives[])
{
    const Status status = instance_update_results(instance);
    for (size_t i = OUTPUT_COUNT; status == STATUS_OK && i < RESULT_COUNT; i++) {
        derivatives[i - OUTPUT_COUNT] = instance->results[i];
    }
    return status;
}

Status instance_set_states(Instance *instance, const double states[])
{
    for (size_t i = INPUT_COUNT; i < NAMED_COUNT; i++) {
        if (!is_finite(states[i - INPUT_COUNT])) {
            return instance_tell(instance, STATUS_DISCARD,
                                 "argument `continuousStates`: %g is not finite; the states stay what they were",
                                 states[i - INPUT_COUNT]);
        }
    }
    for (size_t i = INPUT_COUNT; i < NAMED_COUNT; i++) {
        instance->now.columns[i] = states[i - INPUT_COUNT];
    }
    instance->stale = true;
    return STATUS_OK;
}

#if MODEL_HAS_STATES
/* Reports a state that no motion reaches, and when, in seconds since the beginning of a step. A negative time means no step. */
static Status tell_implausible(Instance *instance, Status status, size_t state, double value, double after)
{
    const Column *column = &model_columns[INPUT_COUNT + state];
    char when[VALID_SIZE] = "";
    char valid[VALID_SIZE] = "all numbers";
    if (is_finite(column->min)) {
        domain_describe(column, valid);
    }
    if (after >= 0.0) {
        snprintf(when, VALID_SIZE, "%.10g s after the beginning of the step, ", after);
    }
    return instance_end(instance, status,
                        "%sstate `%.100s` is %.10g, which is not plausible: expected %s, and at most %.10g in "
                        "magnitude; the motion diverges",
                        when, column->name, value, valid, model_scales[state].limit);
}
#endif

#if MODEL_GOES_ON
/*
 * Integrates the states over a communication step that ends at `time`, or advances from sample to sample. Inputs follow
 * the derivatives from the host.
 */
static Status advance_states(Instance *instance, double time, double size, Status refused)
{
    Snapshot *now = &instance->now;
#if MODEL_HAS_STATES
    /* computed with the results */
    const double *derivatives = instance->stale ? NULL : instance->results + OUTPUT_COUNT;
#else
    const double *derivatives = NULL;
#endif
    const Step step = {size, now->tolerance, derivatives, now->rates[0], now->rates[1], now->policy == POLICY_CLAMP};
    Failure failure = {0.0, 0, 0.0};
    instance_update_point(instance);
    /* even if the step fails, the point no longer belongs to the results */
    instance->stale = true;
    for (size_t i = 0; i < INPUT_COUNT; i++) {
        if (model_columns[i].role == ROLE_INPUT) {
            instance->point[i] = now->columns[i]; /* clamped during the step */
        }
    }
    switch (model_advance(&instance->scratch, instance->point, &step, &failure)) {
    case ADVANCE_DONE:
        break;
    case ADVANCE_NOT_FINITE:
        return instance_end(instance, refused,
                            MODEL_HAS_STATES
                                ? "the states are not finite %.10g s after the beginning of the step: the motion "
                                  "diverges, or reaches a state in which the equations have no finite solution"
                                : "the outputs are not finite at the sample %.10g s after the beginning of the step: "
                                  "the model diverges",
                            instance->since + failure.after);
    case ADVANCE_IMPLAUSIBLE:
#if MODEL_HAS_STATES
        return tell_implausible(instance, refused, failure.state, failure.value, instance->since + failure.after);
#endif
    case ADVANCE_UNDERFLOW:
        return instance_end(instance, refused,
                            "no step of the solver is short enough %.10g s after the beginning of the step: the motion "
                            "diverges, or the equations have a singularity",
                            instance->since + failure.after);
    case ADVANCE_TOO_MANY_STEPS:
        return instance_tell(instance, STATUS_ERROR,
                             "communication step size %.10g takes more than ten million steps of the solver, expected "
                             "a smaller one",
                             size);
    }
    for (size_t i = INPUT_COUNT; i < NAMED_COUNT; i++) {
        if (domain_forbids(instance, i, instance->point[i], time, now->policy, refused)) {
            return refused;
        }
    }
    for (size_t i = INPUT_COUNT; i < COLUMN_COUNT; i++) {
        now->columns[i] = instance->point[i];
    }
    for (size_t i = INPUT_COUNT; i < NAMED_COUNT; i++) {
        domain_note_value(instance, i);
    }
    return STATUS_OK;
}
#endif

/* ---- Time ---- */

static Status check_accepted(Instance *instance)
{
    if (instance->now.time <= instance->now.start_time) {
        memcpy(instance->now.at_start, instance->now.columns, sizeof instance->now.at_start);
    }
#if MODEL_HAS_STATES
    for (size_t i = 0; i < STATE_COUNT; i++) {
        const double value = instance->now.columns[INPUT_COUNT + i];
        if (!(fabs(value) <= model_scales[i].limit)) {
            return tell_implausible(instance, STATUS_ERROR, i, value, -1.0);
        }
    }
#endif
    if (domain_forbids_point(instance, instance->now.policy)) {
        return STATUS_ERROR;
    }
    const Status status = domain_note_data(instance, STATUS_ERROR);
    for (size_t i = 0; i < NAMED_COUNT && status == STATUS_OK; i++) {
        domain_note_value(instance, i);
    }
    return status;
}

/* Notes a time that a solver goes to. A host that never completes a step accepts every point that it leaves behind. */
static Status note_trial(Instance *instance, double time)
{
    if (time <= instance->furthest) {
        return STATUS_OK;
    }
    instance->furthest = time;
    if (instance->trials <= MOST_TRIALS) {
        instance->trials++;
    }
    return instance->trials > MOST_TRIALS ? check_accepted(instance) : STATUS_OK;
}

Status instance_set_time(Instance *instance, double time, Status refused)
{
    if (is_trial(instance)) {
        const Status status = note_trial(instance, time);
        if (status != STATUS_OK) {
            return status;
        }
    }
    for (size_t i = 0; i < INPUT_COUNT; i++) {
        if (model_columns[i].role != ROLE_TIME) {
            continue;
        }
        if (!is_trial(instance) && domain_forbids(instance, i, time, time, instance->now.policy, refused)) {
            return refused;
        }
        instance->now.columns[i] = time;
        instance->stale = true;
        if (!is_trial(instance)) {
            domain_note_value(instance, i);
        }
    }
    instance->now.time = time;
    return STATUS_OK;
}

/* Returns an input `size` seconds later, following its derivatives from the host. It keeps its value if the result is not finite. */
static double extrapolated(const Instance *instance, size_t index, double size)
{
    const double value = instance->now.columns[index];
    const double rate = instance->now.rates[0][index] + 0.5 * size * instance->now.rates[1][index];
    const double later = value + size * rate;
    return is_finite(later) ? later : value;
}

static bool forbids_inputs(Instance *instance, double size, Status status)
{
    for (size_t i = 0; i < INPUT_COUNT; i++) {
        if (model_columns[i].role == ROLE_INPUT &&
            domain_forbids(instance, i, extrapolated(instance, i, size), instance->now.time + size, instance->now.policy,
                    status)) {
            return true;
        }
    }
    return false;
}

static void advance_input(Instance *instance, size_t index, double size)
{
    instance->now.columns[index] = extrapolated(instance, index, size);
    instance->now.rates[0][index] += size * instance->now.rates[1][index];
    instance->stale = true;
    domain_note_value(instance, index);
}

static void advance_inputs(Instance *instance, double size)
{
    const size_t measured_count = MEASURED_COUNT;
    for (size_t i = 0; i < INPUT_COUNT; i++) {
        if (model_columns[i].role == ROLE_INPUT) {
            advance_input(instance, i, size);
        }
    }
    for (size_t i = 0; i < measured_count; i++) {
        advance_input(instance, FIRST_MEASURED + i, size);
    }
}

/* Returns the status of a refused step. Discard means a partly computed step in FMI 2.0, and a step that may be tried again in FMI 3.0. */
static Status refusal_of_step(const Instance *instance)
{
    return instance->fmi_version == 2 ? STATUS_ERROR : STATUS_DISCARD;
}

/* Smallest size of a communication step that is not zero, in s: shorter ones cannot be divided. */
#define SMALLEST_STEP 1e-30

/* Returns how far the clocks of host and instance may be apart: by rounding in single precision, and by at most a tenth of the step. */
static double clock_tolerance(double from, double size)
{
    const double of_double = 1e-6 * size + 1e-9 * fabs(from);
    const double of_single = 2.5e-7 * fabs(from) < 0.1 * size ? 2.5e-7 * fabs(from) : 0.1 * size;
    return of_single > of_double ? of_single : of_double;
}

Status instance_check_step(Instance *instance, double from, double size)
{
    const double tolerance = clock_tolerance(from, size);
    const double time = from + size;
    const Status refused = refusal_of_step(instance);
    if (!is_finite(from)) {
        return instance_not_finite(instance, "currentCommunicationPoint", from);
    }
    if (!is_finite(size)) {
        return instance_not_finite(instance, "communicationStepSize", size);
    }
    if (size < 0.0) {
        return instance_tell(instance, STATUS_ERROR, "communication step size %.10g is negative", size);
    }
    if (size > 0.0 && size < SMALLEST_STEP) {
        return instance_tell(instance, STATUS_ERROR,
                             "communication step size %.10g is below %.10g s, the smallest one, and not zero", size,
                             SMALLEST_STEP);
    }
    if (fabs(from - instance->now.time) > tolerance) {
        return instance_tell(instance, STATUS_ERROR,
                             "current communication point is %.17g, expected %.17g, where the last step ended", from,
                             instance->now.time);
    }
    if (!is_finite(time)) {
        return instance_not_finite(instance, "currentCommunicationPoint + communicationStepSize", time);
    }
    /* "if the environment tries to compute past stopTime the FMU has to return fmi2Error" */
    if (time > instance->now.stop_time + tolerance) {
        return instance_tell(instance, STATUS_ERROR, "a step to %.17g would go past the stop time %.17g", time,
                             instance->now.stop_time);
    }
    return forbids_inputs(instance, size, refused) ? refused : STATUS_OK;
}

Status instance_do_step(Instance *instance, double from, double size)
{
    const Status refused = refusal_of_step(instance);
    const double time = from + size;
    Status status = instance_check_step(instance, from, size);
    if (status != STATUS_OK) {
        return status;
    }
    status = domain_note_data(instance, refused);
    if (status != STATUS_OK) {
        return status;
    }
#if MODEL_GOES_ON
    status = advance_states(instance, time, size, refused);
    if (status != STATUS_OK) {
        return status;
    }
#endif
    status = instance_set_time(instance, time, refused);
    if (status == STATUS_OK) {
        advance_inputs(instance, size);
    }
    return status;
}

double instance_updates(double size)
{
#if MODEL_HAS_STATES
    const double steps = ceil(size / model_solver_step * (1.0 - 1e-9)); /* as in states.c */
    /* the solver refuses too many */
    return steps >= 1.0 && steps <= MAX_STEPS ? steps : 1.0;
#else
    (void)size;
    return 1.0;
#endif
}

Status instance_accept_point(Instance *instance)
{
    instance->trials = 0;
    return check_accepted(instance);
}

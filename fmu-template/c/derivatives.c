#include "parts.h"
#include <string.h>

/* Knowns that are no columns: a time that is none, on which bounds alone depend, and switches, on which nothing depends continuously. */
enum { TIME_ALONE = COLUMN_COUNT, SWITCH };

/* Returns true if a known is an integer or Boolean. */
static bool is_switch(const Instance *instance, uint32_t known)
{
    return is(instance, known, VARIABLE_DOMAIN_POLICY) || is(instance, known, VARIABLE_USE_MEASURED);
}

/* Returns the column of a known, TIME_ALONE or SWITCH. */
static size_t column_of(const Instance *instance, uint32_t known)
{
    const size_t index = model_variables[known].index;
    if (is(instance, known, VARIABLE_TIME)) {
        return TIME_ALONE;
    }
    if (is_switch(instance, known)) {
        return SWITCH;
    }
    if (!is(instance, known, VARIABLE_COLUMN) || model_columns[index].role != ROLE_START || !is_starting(instance)) {
        return variable_column(instance, known);
    }
    /* until the simulation runs, these parameters define the states */
    size_t state = INPUT_COUNT;
    for (size_t i = 0; i < index; i++) {
        state += model_columns[i].role == ROLE_START ? 1 : 0;
    }
    return state;
}

static Status check_known(Instance *instance, uint32_t reference)
{
    if (is(instance, reference, VARIABLE_COLUMN) || is(instance, reference, VARIABLE_STATE) ||
        is(instance, reference, VARIABLE_MEASURED) || is(instance, reference, VARIABLE_TIME) ||
        is_switch(instance, reference)) {
        return STATUS_OK;
    }
    if (!exists(instance, reference)) {
        return variable_wrong(instance, reference, "");
    }
    return instance_tell(instance, STATUS_ERROR,
                         "variable `%.100s` (value reference %lu) is no input, parameter, state or time",
                         variable_name(reference), (unsigned long)reference);
}

static Status check_unknown(Instance *instance, uint32_t reference)
{
    size_t result = 0;
    if (variable_is_result(instance, reference, &result) || is(instance, reference, VARIABLE_STATE) ||
        is(instance, reference, VARIABLE_DOMAIN_DISTANCE) || is(instance, reference, VARIABLE_BOUND) ||
        is(instance, reference, VARIABLE_IN_DOMAIN)) {
        return STATUS_OK;
    }
    if (!exists(instance, reference)) {
        return variable_wrong(instance, reference, "");
    }
    return instance_tell(instance, STATUS_ERROR,
                         "variable `%.100s` (value reference %lu) is no continuous output, state or derivative of one",
                         variable_name(reference), (unsigned long)reference);
}

static Status check_sensitivity(Instance *instance, const uint32_t unknowns[], size_t unknown_count,
                                const uint32_t knowns[], size_t known_count, const double seed[], size_t seed_count)
{
    for (size_t i = 0; i < unknown_count; i++) {
        if (check_unknown(instance, unknowns[i]) != STATUS_OK) {
            return STATUS_ERROR;
        }
    }
    for (size_t i = 0; i < known_count; i++) {
        if (check_known(instance, knowns[i]) != STATUS_OK) {
            return STATUS_ERROR;
        }
    }
    for (size_t i = 0; i < seed_count; i++) {
        if (!is_finite(seed[i])) {
            return instance_not_finite(instance, "seed", seed[i]);
        }
    }
    return STATUS_OK;
}

/* Zeroes directions in which the policy clamps: they have no effect on the surrogate's outputs. */
static void zero_clamped(const Instance *instance, double columns[COLUMN_COUNT])
{
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        if (instance->now.policy == POLICY_CLAMP && !(instance->point[i] == instance->now.columns[i])) {
            columns[i] = 0.0;
        }
    }
}

/* Zeroes the inputs of a discrete-time model until the simulation runs: only parameters define its outputs then. */
static void zero_at_start(const Instance *instance, double columns[COLUMN_COUNT])
{
    const bool is_of_samples = MODEL_GOES_ON && !MODEL_HAS_STATES;
    for (size_t i = 0; is_of_samples && i < INPUT_COUNT; i++) {
        if (model_columns[i].role == ROLE_INPUT && is_starting(instance)) {
            columns[i] = 0.0;
        }
    }
}

/* Returns the change of an unknown, given the changes of results, columns, distance from the domain, and time. */
static double change_of(const Instance *instance, uint32_t unknown, const double results[RESULT_COUNT],
                        const double columns[COLUMN_COUNT], double distance_change, double time_change)
{
    size_t result = 0;
    if (variable_is_result(instance, unknown, &result)) {
        return results[result];
    }
    if (is(instance, unknown, VARIABLE_STATE)) {
        return columns[INPUT_COUNT + model_variables[unknown].index];
    }
    if (is(instance, unknown, VARIABLE_BOUND)) {
        return variable_bound(instance, model_variables[unknown].index).rate * time_change;
    }
    if (is(instance, unknown, VARIABLE_IN_DOMAIN)) {
        return 0.0;
    }
    return distance_change;
}

Status instance_directional_derivative(Instance *instance, const uint32_t unknowns[], size_t unknown_count,
                                       const uint32_t knowns[], size_t known_count, const double seed[],
                                       double sensitivity[])
{
    double direction[COLUMN_COUNT] = {0.0};
    double derivative[RESULT_COUNT];
    double of_time = 0.0;
    const Outside farthest = domain_outside(instance, 0);
    if (check_sensitivity(instance, unknowns, unknown_count, knowns, known_count, seed, known_count) != STATUS_OK) {
        return STATUS_ERROR;
    }
    for (size_t i = 0; i < known_count; i++) {
        const size_t column = column_of(instance, knowns[i]);
        if (column < COLUMN_COUNT) {
            direction[column] += seed[i];
        } else if (column == TIME_ALONE) {
            of_time += seed[i];
        }
    }
    const double of_distance = farthest.slope * direction[farthest.column];
    instance_update_point(instance);
    zero_clamped(instance, direction);
    zero_at_start(instance, direction);
    model_directional(&instance->scratch, instance->point, direction, derivative);
    for (size_t i = 0; i < unknown_count; i++) {
        sensitivity[i] = change_of(instance, unknowns[i], derivative, direction, of_distance, of_time);
    }
    return instance_check_derivatives(instance, sensitivity, unknown_count);
}

Status instance_adjoint_derivative(Instance *instance, const uint32_t unknowns[], size_t unknown_count,
                                   const uint32_t knowns[], size_t known_count, const double seed[],
                                   double sensitivity[])
{
    double weights[RESULT_COUNT] = {0.0};
    double direct[COLUMN_COUNT] = {0.0}; /* for unknowns that are states themselves */
    double weight_of_distance = 0.0;
    double of_time = 0.0;
    double gradient[COLUMN_COUNT];
    const Outside farthest = domain_outside(instance, 0);
    if (check_sensitivity(instance, unknowns, unknown_count, knowns, known_count, seed, unknown_count) != STATUS_OK) {
        return STATUS_ERROR;
    }
    for (size_t i = 0; i < unknown_count; i++) {
        size_t result = 0;
        if (variable_is_result(instance, unknowns[i], &result)) {
            weights[result] += seed[i];
        } else if (is(instance, unknowns[i], VARIABLE_STATE)) {
            direct[column_of(instance, unknowns[i])] += seed[i];
        } else if (is(instance, unknowns[i], VARIABLE_BOUND)) {
            of_time += seed[i] * variable_bound(instance, model_variables[unknowns[i]].index).rate;
        } else if (is(instance, unknowns[i], VARIABLE_DOMAIN_DISTANCE)) {
            weight_of_distance += seed[i];
        }
    }
    instance_update_point(instance);
    model_adjoint(&instance->scratch, instance->point, weights, gradient);
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        gradient[i] += direct[i];
    }
    zero_clamped(instance, gradient);
    zero_at_start(instance, gradient);
    gradient[farthest.column] += farthest.slope * weight_of_distance;
    for (size_t i = 0; i < known_count; i++) {
        const size_t column = column_of(instance, knowns[i]);
        const double of_others = column == TIME_ALONE ? of_time : 0.0;
        sensitivity[i] = column < COLUMN_COUNT ? gradient[column] : of_others;
    }
    return instance_check_derivatives(instance, sensitivity, known_count);
}

static Status check_order(Instance *instance, int32_t order)
{
    if (order >= 1 && order <= DERIVATIVE_ORDERS) {
        return STATUS_OK;
    }
    return instance_tell(instance, STATUS_ERROR, "derivatives of order %ld are not available, expected 1 to %d",
                         (long)order, (int)DERIVATIVE_ORDERS);
}

Status instance_output_derivatives(Instance *instance, const uint32_t references[], size_t count,
                                   const int32_t orders[], double values[])
{
    double rates[DERIVATIVE_ORDERS][COLUMN_COUNT];
    double derivatives[DERIVATIVE_ORDERS][RESULT_COUNT];
    double of_distance[DERIVATIVE_ORDERS];
    const bool is_of_samples = MODEL_GOES_ON && !MODEL_HAS_STATES;
    if (is_of_samples) {
        return instance_tell(instance, STATUS_ERROR,
                             "there are no derivatives of outputs with respect to time: they are linear between samples, "
                             "and bend there");
    }
    const Outside farthest = domain_outside(instance, 0);
    for (size_t i = 0; i < count; i++) {
        if (check_unknown(instance, references[i]) != STATUS_OK) {
            return STATUS_ERROR;
        }
    }
    for (size_t i = 0; i < count; i++) {
        if (check_order(instance, orders[i]) != STATUS_OK) {
            return STATUS_ERROR;
        }
    }
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        rates[0][i] = i < INPUT_COUNT && model_columns[i].role == ROLE_TIME ? 1.0 : instance->now.rates[0][i];
        rates[1][i] = instance->now.rates[1][i];
    }
    instance_update_point(instance);
    if (STATE_COUNT > 0) {
        const Status status = instance_get_derivatives(instance, rates[0] + INPUT_COUNT);
        if (status != STATUS_OK) {
            return status;
        }
    }
    of_distance[0] = farthest.slope * rates[0][farthest.column];
    zero_clamped(instance, rates[0]);
    if (STATE_COUNT > 0) {
        model_directional(&instance->scratch, instance->point, rates[0], derivatives[0]);
        memcpy(rates[1] + INPUT_COUNT, derivatives[0] + OUTPUT_COUNT, STATE_COUNT * sizeof(double));
    }
    of_distance[1] = farthest.slope * rates[1][farthest.column];
    zero_clamped(instance, rates[1]);
    model_along_curve(&instance->scratch, instance->point, rates[0], rates[1], derivatives[0], derivatives[1]);
    for (size_t i = 0; i < count; i++) {
        const size_t order = (size_t)orders[i] - 1;
        /* bounds are linear in time */
        const double of_time = order == 0 ? 1.0 : 0.0;
        values[i] = change_of(instance, references[i], derivatives[order], rates[order], of_distance[order], of_time);
    }
    return instance_check_derivatives(instance, values, count);
}

static Status check_input(Instance *instance, uint32_t reference)
{
    const bool is_driven = is(instance, reference, VARIABLE_COLUMN) &&
                           model_columns[model_variables[reference].index].role == ROLE_INPUT;
    if (is_driven || is(instance, reference, VARIABLE_MEASURED)) {
        return STATUS_OK;
    }
    if (!exists(instance, reference)) {
        return variable_wrong(instance, reference, "");
    }
    return instance_tell(instance, STATUS_ERROR, "variable `%.100s` (value reference %lu) is no input",
                         variable_name(reference), (unsigned long)reference);
}

Status instance_set_input_derivatives(Instance *instance, const uint32_t references[], size_t count,
                                      const int32_t orders[], const double values[])
{
    for (size_t i = 0; i < count; i++) {
        if (check_input(instance, references[i]) != STATUS_OK || check_order(instance, orders[i]) != STATUS_OK) {
            return STATUS_ERROR;
        }
        if (!is_finite(values[i])) {
            return instance_not_finite(instance, "value", values[i]);
        }
    }
    for (size_t i = 0; i < count; i++) {
        instance->now.rates[orders[i] - 1][variable_column(instance, references[i])] = values[i];
    }
    return STATUS_OK;
}

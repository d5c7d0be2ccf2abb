#include "parts.h"

static uint32_t last_reference(const Instance *instance)
{
    uint32_t last = REFERENCE_COUNT - 1;
    while (!exists(instance, last)) {
        last--;
    }
    return last;
}

static const char *variable_type(uint32_t reference)
{
    switch (model_variables[reference].quantity) {
    case VARIABLE_DOMAIN_POLICY:
        return "integer";
    case VARIABLE_IN_DOMAIN:
    case VARIABLE_USE_MEASURED:
        return "Boolean";
    default:
        return "real";
    }
}

Status variable_wrong(Instance *instance, uint32_t reference, const char *asked)
{
    if (reference > last_reference(instance)) {
        return instance_tell(instance, STATUS_ERROR, "value reference %lu is unknown, expected at most %lu",
                             (unsigned long)reference, (unsigned long)last_reference(instance));
    }
    if (!exists(instance, reference)) {
        return instance_tell(instance, STATUS_ERROR, "value reference %lu is unknown: no variable has it",
                             (unsigned long)reference);
    }
    return instance_tell(instance, STATUS_ERROR, "variable `%.100s` (value reference %lu) is of type %s, not %s",
                         variable_name(reference), (unsigned long)reference, variable_type(reference), asked);
}

/* Returns true if a variable has a column that a host may set, and sets its position: the time has its own function. */
static bool find_column(const Instance *instance, uint32_t reference, size_t *column)
{
    if (!exists(instance, reference)) {
        return false;
    }
    const Variable *variable = &model_variables[reference];
    switch (variable->quantity) {
    case VARIABLE_COLUMN:
        *column = variable->index;
        return model_columns[variable->index].role != ROLE_TIME;
    case VARIABLE_STATE:
        *column = INPUT_COUNT + variable->index;
        return true;
    case VARIABLE_MEASURED:
        *column = FIRST_MEASURED + variable->index;
        return true;
    default:
        return false;
    }
}

static Status cannot_set(Instance *instance, uint32_t reference, const char *what)
{
    return instance_tell(instance, STATUS_ERROR, "variable `%.100s` (value reference %lu) is %s and cannot be set",
                         variable_name(reference), (unsigned long)reference, what);
}

bool variable_is_result(const Instance *instance, uint32_t reference, size_t *result)
{
    if (is(instance, reference, VARIABLE_OUTPUT)) {
        *result = model_variables[reference].index;
        return true;
    }
    if (is(instance, reference, VARIABLE_DERIVATIVE)) {
        *result = OUTPUT_COUNT + model_variables[reference].index;
        return true;
    }
    return false;
}

Bound variable_bound(const Instance *instance, size_t output)
{
    const double elapsed = instance->now.time - instance->now.start_time;
    const size_t last = BOUND_TIME_COUNT - 1;
    size_t next = 0;
    while (next <= last && model_bound_times[next] <= elapsed) {
        next++;
    }
    if (next == 0 || next > last) {
        const Bound constant = {model_bounds[(next == 0 ? 0 : last) * OUTPUT_COUNT + output], 0.0};
        return constant;
    }
    const double begin = model_bound_times[next - 1];
    const double size = model_bound_times[next] - begin;
    const double from = model_bounds[(next - 1) * OUTPUT_COUNT + output];
    const double change = model_bounds[next * OUTPUT_COUNT + output] - from;
    const Bound growing = {from + (elapsed - begin) / size * change, change / size};
    return growing;
}

/* Checks that a variable can be read. Before initialization, FMI 3.0 allows reading start values, and FMI 2.0 allows nothing. */
static Status check_readable(Instance *instance, uint32_t reference)
{
    const Variable *variable = &model_variables[reference];
    const bool has_start =
        (variable->quantity == VARIABLE_COLUMN && model_columns[variable->index].role != ROLE_TIME) ||
        (variable->quantity == VARIABLE_BOUND && BOUND_TIME_COUNT <= 1) || variable->quantity == VARIABLE_DOMAIN_POLICY ||
        variable->quantity == VARIABLE_MEASURED || variable->quantity == VARIABLE_USE_MEASURED;
    if (instance->now.state != STATE_INSTANTIATED || has_start) {
        return STATUS_OK;
    }
    return instance_tell(instance, STATUS_ERROR,
                         "variable `%.100s` (value reference %lu) has no start value: it can be read from "
                         "Initialization Mode on",
                         variable_name(reference), (unsigned long)reference);
}

/* Returns the value of an existing real variable. Results must be up to date. */
static double value_of(const Instance *instance, uint32_t reference)
{
    const Variable *variable = &model_variables[reference];
    switch (variable->quantity) {
    case VARIABLE_OUTPUT:
        return instance->results[variable->index];
    case VARIABLE_DERIVATIVE:
        return instance->results[OUTPUT_COUNT + variable->index];
    case VARIABLE_COLUMN:
    case VARIABLE_STATE:
    case VARIABLE_MEASURED:
        return instance->now.columns[variable_column(instance, reference)];
    case VARIABLE_DOMAIN_DISTANCE:
        return domain_outside(instance, instance->centre).distance;
    case VARIABLE_BOUND:
        return variable_bound(instance, variable->index).value;
    /* some hosts read every variable as a real */
    case VARIABLE_IN_DOMAIN:
    case VARIABLE_USE_MEASURED:
        return instance_boolean(instance, reference) ? 1.0 : 0.0;
    case VARIABLE_DOMAIN_POLICY:
        return (double)instance->now.policy;
    default:
        return instance->now.time;
    }
}

static bool is_boolean(const Instance *instance, uint32_t reference)
{
    return is(instance, reference, VARIABLE_IN_DOMAIN) || is(instance, reference, VARIABLE_USE_MEASURED);
}

Status instance_get_real(Instance *instance, const uint32_t references[], size_t count, double values[])
{
    bool of_results = false;
    for (size_t i = 0; i < count; i++) {
        size_t result = 0;
        if (!exists(instance, references[i])) {
            return variable_wrong(instance, references[i], "real");
        }
        if (check_readable(instance, references[i]) != STATUS_OK) {
            return STATUS_ERROR;
        }
        of_results = of_results || variable_is_result(instance, references[i], &result);
    }
    const Status status = of_results ? instance_update_results(instance) : STATUS_OK;
    for (size_t i = 0; i < count && status == STATUS_OK; i++) {
        values[i] = value_of(instance, references[i]);
    }
    return status;
}

Status instance_get_integer(Instance *instance, const uint32_t references[], size_t count, int32_t values[])
{
    for (size_t i = 0; i < count; i++) {
        if (!is(instance, references[i], VARIABLE_DOMAIN_POLICY)) {
            return variable_wrong(instance, references[i], "integer");
        }
    }
    for (size_t i = 0; i < count; i++) {
        values[i] = (int32_t)instance->now.policy;
    }
    return STATUS_OK;
}

Status instance_check_booleans(Instance *instance, const uint32_t references[], size_t count)
{
    for (size_t i = 0; i < count; i++) {
        if (!is_boolean(instance, references[i])) {
            return variable_wrong(instance, references[i], "Boolean");
        }
        if (check_readable(instance, references[i]) != STATUS_OK) {
            return STATUS_ERROR;
        }
    }
    return STATUS_OK;
}

bool instance_boolean(const Instance *instance, uint32_t reference)
{
    if (is(instance, reference, VARIABLE_USE_MEASURED)) {
        return is_measured(instance);
    }
    return domain_contains(instance);
}

/*
 * Returns true if a parameter can be set: a fixed one before the simulation starts, a tunable one also between steps, at events and where a
 * solver tries points. Until time passes, setting a fixed one means what it does in the initialization.
 */
static bool parameter_is_settable(const Instance *instance, bool tunable)
{
    const bool is_early = instance->now.time <= instance->now.start_time;
    unsigned states = STATE_INSTANTIATED | STATE_INITIALIZATION;
    if (tunable || is_early) {
        states |= STATE_EVENT | STATE_STEP;
    }
    if (tunable) {
        states |= STATE_CONTINUOUS_TIME;
    }
    return (states & (unsigned)instance->now.state) != 0;
}

/* A value that stays what it is has no effect: some hosts set all parameters at each step. */
static Status check_parameter(Instance *instance, uint32_t reference, bool tunable, bool is_unchanged)
{
    if (is_unchanged || parameter_is_settable(instance, tunable)) {
        return STATUS_OK;
    }
    return instance_tell(instance, STATUS_ERROR,
                         "parameter `%.100s` (value reference %lu) is %s and cannot be set in state `%s`",
                         variable_name(reference), (unsigned long)reference, tunable ? "tunable" : "fixed",
                         instance_state_name(instance->now.state));
}

/* The independent variable may be set to the value that it has: other values have their own function. */
static Status check_time(Instance *instance, uint32_t reference, double value)
{
    const double now = instance->now.time;
    const double magnitude = fabs(now) > model_time_step ? fabs(now) : model_time_step;
    return fabs(value - now) <= 1e-9 * magnitude ? STATUS_OK : cannot_set(instance, reference, "the independent variable");
}

static Status check_policy(Instance *instance, double value)
{
    if (value == POLICY_WARN || value == POLICY_CLAMP || value == POLICY_ERROR) {
        return STATUS_OK;
    }
    return instance_tell(instance, STATUS_ERROR, "parameter `domain_policy`: %.10g, expected 0 (warn), 1 (clamp) or 2 (error)",
                         value);
}

/* Checks that a variable can be set to a value now. Hosts that set every variable as a real set integers and Booleans, too. */
static Status check_settable(Instance *instance, uint32_t reference, double value)
{
    if (is(instance, reference, VARIABLE_OUTPUT)) {
        return cannot_set(instance, reference, "an output");
    }
    if (is(instance, reference, VARIABLE_DERIVATIVE) || is(instance, reference, VARIABLE_DOMAIN_DISTANCE) ||
        is(instance, reference, VARIABLE_BOUND) || is(instance, reference, VARIABLE_IN_DOMAIN)) {
        return cannot_set(instance, reference, "computed"); /* local variables, or outputs where the FMU has ports for them */
    }
    if (is(instance, reference, VARIABLE_STATE) && is_trial(instance)) {
        return STATUS_OK; /* allowed by both standards, besides fmi3SetContinuousStates */
    }
    if (is(instance, reference, VARIABLE_STATE)) {
        return instance_tell(instance, STATUS_ERROR,
                             "variable `%.100s` (value reference %lu) is a state and cannot be set: set parameter "
                             "`%.100s_start` before the simulation runs, or the state in Continuous-Time Mode",
                             variable_name(reference), (unsigned long)reference, variable_name(reference));
    }
    if (is(instance, reference, VARIABLE_TIME)) {
        return check_time(instance, reference, value);
    }
    if (is(instance, reference, VARIABLE_MEASURED) || is(instance, reference, VARIABLE_USE_MEASURED)) {
        return STATUS_OK;
    }
    if (is(instance, reference, VARIABLE_DOMAIN_POLICY)) {
        return check_parameter(instance, reference, true, value == (double)instance->now.policy);
    }
    if (!is(instance, reference, VARIABLE_COLUMN)) {
        return variable_wrong(instance, reference, "real");
    }
    const size_t column = model_variables[reference].index;
    switch (model_columns[column].role) {
    case ROLE_TIME:
        return check_time(instance, reference, value);
    case ROLE_INPUT:
        return STATUS_OK;
    default:
        return check_parameter(instance, reference, model_columns[column].role == ROLE_TUNABLE_PARAMETER,
                               value == instance->now.columns[column]);
    }
}

static void set_policy(Instance *instance, Policy policy)
{
    instance->now.policy = policy;
    instance->stale = true;
    if (MODEL_GOES_ON && !MODEL_HAS_STATES) {
        instance_initialize_states(instance);
    }
}

static void set_column(Instance *instance, size_t column, double value)
{
    Snapshot *now = &instance->now;
    const bool is_parameter = column < INPUT_COUNT && model_columns[column].role != ROLE_INPUT;
    const bool is_other = !(value == now->columns[column]);
    now->columns[column] = value;
    if (now->time <= now->start_time) {
        now->at_start[column] = value;
        if (is_parameter && is_other && !is_starting(instance)) {
            instance_restart(instance, column);
        }
    }
    if (!is_trial(instance)) {
        domain_note_value(instance, column);
    }
}

/* Checks that neither domain_policy nor the domain forbids a value. */
static Status check_domain(Instance *instance, uint32_t reference, double value)
{
    const Snapshot *now = &instance->now;
    size_t column = 0;
    if (is(instance, reference, VARIABLE_DOMAIN_POLICY)) {
        const bool is_fine = check_policy(instance, value) == STATUS_OK && !domain_forbids_point(instance, (Policy)value);
        return is_fine ? STATUS_OK : STATUS_ERROR;
    }
    const bool is_checked = !is_trial(instance) && find_column(instance, reference, &column);
    return is_checked && domain_forbids(instance, column, value, now->time, now->policy, STATUS_ERROR) ? STATUS_ERROR : STATUS_OK;
}

/* Sets a variable for which check_settable found nothing. */
static void set_real(Instance *instance, uint32_t reference, double value)
{
    size_t column = 0;
    if (is(instance, reference, VARIABLE_DOMAIN_POLICY)) {
        set_policy(instance, (Policy)value);
    } else if (is(instance, reference, VARIABLE_USE_MEASURED)) {
        instance_use_measured(instance, value < 0.0 || value > 0.0);
    } else if (find_column(instance, reference, &column)) {
        set_column(instance, column, value);
    }
}

Status instance_set_real(Instance *instance, const uint32_t references[], size_t count, const double values[])
{
    for (size_t i = 0; i < count; i++) {
        if (check_settable(instance, references[i], values[i]) != STATUS_OK) {
            return STATUS_ERROR;
        }
        if (!is_finite(values[i])) {
            return instance_tell(instance, is_trial(instance) ? STATUS_DISCARD : STATUS_ERROR,
                                 "variable `%.100s` (value reference %lu): %g is not finite",
                                 variable_name(references[i]), (unsigned long)references[i], values[i]);
        }
        if (check_domain(instance, references[i], values[i]) != STATUS_OK) {
            return STATUS_ERROR;
        }
    }
    for (size_t i = 0; i < count; i++) {
        set_real(instance, references[i], values[i]);
        instance->stale = true;
    }
    instance_initialize_states(instance);
    return STATUS_OK;
}

Status instance_set_integer(Instance *instance, const uint32_t references[], size_t count, const int32_t values[])
{
    for (size_t i = 0; i < count; i++) {
        if (!is(instance, references[i], VARIABLE_DOMAIN_POLICY)) {
            return variable_wrong(instance, references[i], "integer");
        }
        const bool is_unchanged = values[i] == (int32_t)instance->now.policy;
        if (check_policy(instance, (double)values[i]) != STATUS_OK ||
            check_parameter(instance, references[i], true, is_unchanged) != STATUS_OK) {
            return STATUS_ERROR;
        }
    }
    if (count > 0 && domain_forbids_point(instance, (Policy)values[count - 1])) {
        return STATUS_ERROR;
    }
    if (count > 0) {
        set_policy(instance, (Policy)values[count - 1]);
    }
    return STATUS_OK;
}

Status instance_check_set_boolean(Instance *instance, const uint32_t references[], size_t count)
{
    for (size_t i = 0; i < count; i++) {
        if (is(instance, references[i], VARIABLE_IN_DOMAIN)) {
            return cannot_set(instance, references[i], "computed");
        }
        if (!is(instance, references[i], VARIABLE_USE_MEASURED)) {
            return variable_wrong(instance, references[i], "Boolean");
        }
    }
    return STATUS_OK;
}

void instance_use_measured(Instance *instance, bool on)
{
    instance->now.columns[FIRST_MEASURED + MEASURED_COUNT] = on ? 1.0 : 0.0;
}

Status instance_check_intermediate(Instance *instance, uint32_t reference)
{
    return exists(instance, reference) ? STATUS_OK : variable_wrong(instance, reference, "");
}

Status instance_count_dependencies(Instance *instance, uint32_t reference, size_t *count)
{
    if (!exists(instance, reference)) {
        return variable_wrong(instance, reference, "");
    }
    size_t result = 0;
    *count = 0;
    if (variable_is_result(instance, reference, &result)) {
        *count = NAMED_COUNT + 1;
    } else if (is(instance, reference, VARIABLE_IN_DOMAIN) || is(instance, reference, VARIABLE_DOMAIN_DISTANCE)) {
        *count = NAMED_COUNT;
    }
    return STATUS_OK;
}

uint32_t instance_dependency(size_t i)
{
    if (i >= NAMED_COUNT) {
        return POLICY_REFERENCE;
    }
    /* outputs are between the inputs and the states */
    return (uint32_t)(FIRST_REFERENCE + (i < INPUT_COUNT ? i : OUTPUT_COUNT + i));
}

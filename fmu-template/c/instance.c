#include "instance.h"
#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

enum { VALID_SIZE = 200 }; /* of the words for what is valid */

/* How far outside its range a value may be, relative to the range: hosts add up step sizes and convert units. */
static const double TOLERANCE = 1e-9;

static const char CATEGORY_ERROR[] = "logStatusError";
static const char CATEGORY_WARNING[] = "logStatusWarning";
static const char CATEGORY_ALL[] = "logAll";

/* ---- Instances and messages ---- */

/* FNV-1a, 64 bits: any change of a single byte changes it. */
static uint64_t hash(uint64_t start, const uint8_t *bytes, size_t count)
{
    uint64_t result = start;
    for (size_t i = 0; i < count; i++) {
        result = (result ^ bytes[i]) * 0x100000001b3u;
    }
    return result;
}

static const uint64_t HASH_START = 0xcbf29ce484222325u;

static uint64_t fingerprint(const Instance *instance)
{
    const uint8_t kind[2] = {(uint8_t)instance->fmi_version, instance->interface == CO_SIMULATION ? 1 : 0};
    const uint64_t of_token = hash(HASH_START, (const uint8_t *)model_token, strlen(model_token));
    return hash(of_token, kind, sizeof kind);
}

static bool is_blank(const char *text)
{
    return text == NULL || text[strspn(text, " \t\r\n\v\f")] == '\0';
}

void instance_initialize(Instance *instance, const char *function)
{
    instance->centre = 0;
    instance->function = function;
    instance->now.fingerprint = fingerprint(instance);
    for (size_t i = 0; i < RESULT_COUNT; i++) {
        instance->results[i] = 0.0;
    }
    instance_reset(instance);
}

bool instance_check_name(Instance *instance, const char *name)
{
    if (!is_blank(name)) {
        return true;
    }
    instance_tell(instance, STATUS_ERROR, "the instance name is empty");
    return false;
}

bool instance_check_token(Instance *instance, const char *token, const char *argument)
{
    const bool only_co_simulation = MODEL_GOES_ON && !MODEL_HAS_STATES;
    if (instance_lacks(instance, token, 1, argument)) {
        return false;
    }
    if (strcmp(token, model_token) != 0) {
        instance_tell(instance, STATUS_ERROR,
                      "the GUID or instantiation token is `%.100s`, expected `%s`: modelDescription.xml and the "
                      "sources do not belong together",
                      token, model_token);
        return false;
    }
    if (only_co_simulation && instance->interface == MODEL_EXCHANGE) {
        instance_tell(instance, STATUS_ERROR,
                      "this FMU is discrete-time: it is for co-simulation, not for model exchange");
        return false;
    }
    return true;
}

static const char *state_name(State state)
{
    switch (state) {
    case STATE_INSTANTIATED:
        return "instantiated";
    case STATE_INITIALIZATION:
        return "Initialization Mode";
    case STATE_EVENT:
        return "Event Mode";
    case STATE_CONTINUOUS_TIME:
        return "Continuous-Time Mode";
    case STATE_STEP:
        return "Step Mode";
    case STATE_TERMINATED:
        return "terminated";
    case STATE_UPDATE:
        return "Intermediate Update Mode";
    default:
        return "error";
    }
}

/* States in which a call is allowed, with the interface of the instance. */
static unsigned legal_states(const Instance *instance, unsigned allowed)
{
    return allowed >> (unsigned)instance->interface & 0xffu;
}

static void tell_illegal_state(Instance *instance, unsigned allowed)
{
    char list[192] = "";
    const unsigned possible = MODEL_HAS_STATES ? ~0u : ~(unsigned)STATE_UPDATE;
    const unsigned legal = legal_states(instance, allowed) & possible;
    size_t length = 0;
    for (unsigned state = STATE_INSTANTIATED; state <= STATE_UPDATE; state *= 2) {
        if ((legal & state) != 0) {
            const int added = snprintf(list + length, sizeof list - length, "%s`%s`", length > 0 ? ", " : "",
                                       state_name((State)state));
            length += (size_t)added;
        }
    }
    instance_tell(instance, STATUS_ERROR, "not allowed in state `%s`, only in %s", state_name(instance->now.state),
                  length > 0 ? list : "a state this FMU never enters");
}

bool instance_begin(Instance *instance, const char *function, unsigned allowed)
{
    if (instance == NULL) {
        return false;
    }
    instance->function = function;
    if ((legal_states(instance, allowed) & (unsigned)instance->now.state) != 0) {
        return true;
    }
    tell_illegal_state(instance, allowed);
    return false;
}

/* Hosts replace `#7#` by the variable's name, so a plain `#` is written twice. */
static void escape(const char *from, char *to, size_t size)
{
    size_t length = 0;
    for (; *from != '\0' && length + 3 <= size; from++) {
        to[length++] = *from;
        if (*from == '#') {
            to[length++] = '#';
        }
    }
    to[length] = '\0';
}

static void send_message(const Instance *instance, Status status, const char *message)
{
    bool on = instance->log_everything;
    const char *category = CATEGORY_ALL;
    if (status == STATUS_ERROR) {
        on = true; /* whatever the settings: fmi2Error says so, and FMI 3.0.3 */
        category = CATEGORY_ERROR;
    } else if (status != STATUS_OK) {
        on = instance->log_warnings;
        category = CATEGORY_WARNING;
    }
    if (on) {
        instance->send(instance, status, category, message);
    }
}

Status instance_tell(Instance *instance, Status status, const char *format, ...)
{
    char message[MESSAGE_SIZE];
    char escaped[MESSAGE_SIZE];
    va_list arguments;
    int length = snprintf(message, sizeof message, "%s: ", instance->function);
    va_start(arguments, format);
    vsnprintf(message + length, sizeof message - (size_t)length, format, arguments);
    va_end(arguments);
    escape(message, escaped, sizeof escaped);
    if (status == STATUS_ERROR) {
        instance->now.state = instance->fmi_version == 2 ? STATE_ERROR : STATE_TERMINATED;
    }
    send_message(instance, status, escaped);
    return status;
}

static void switch_all(Instance *instance, bool on)
{
    instance->log_warnings = on;
    instance->log_everything = on;
}

static void switch_category(Instance *instance, bool on, const char *category)
{
    if (strcmp(category, CATEGORY_WARNING) == 0) {
        instance->log_warnings = on;
    } else if (strcmp(category, CATEGORY_ALL) == 0) {
        switch_all(instance, on);
    }
}

static bool is_category(const char *name)
{
    return strcmp(name, CATEGORY_ERROR) == 0 || strcmp(name, CATEGORY_WARNING) == 0 || strcmp(name, CATEGORY_ALL) == 0;
}

Status instance_switch_logging(Instance *instance, bool on, size_t count, const char *const categories[])
{
    size_t given = 0;
    if (count == 0) {
        switch_all(instance, on);
    }
    if (instance_lacks(instance, categories, count, "categories")) {
        return STATUS_ERROR;
    }
    while (given < count && categories[given] != NULL) {
        switch_category(instance, on, categories[given]);
        given++;
    }
    /* as the categories are now */
    for (size_t i = 0; i < given; i++) {
        if (!is_category(categories[i])) {
            /* not an error: an unknown category is no reason to end a simulation */
            instance_tell(instance, STATUS_WARNING,
                          "log category `%.100s` is unknown, expected one of `%s`, `%s`, `%s`", categories[i],
                          CATEGORY_ERROR, CATEGORY_WARNING, CATEGORY_ALL);
        }
    }
    return instance_lacks(instance, NULL, count - given, "categories") ? STATUS_ERROR : STATUS_OK;
}

bool instance_lacks(Instance *instance, const void *pointer, size_t count, const char *argument)
{
    if (pointer != NULL || count == 0) {
        return false;
    }
    instance_tell(instance, STATUS_ERROR, "argument `%s` is a null pointer", argument);
    return true;
}

bool instance_miscounts(Instance *instance, size_t found, size_t expected, const char *argument)
{
    if (found == expected) {
        return false;
    }
    instance_tell(instance, STATUS_ERROR, "argument `%s`: %lu elements, expected %lu", argument, (unsigned long)found,
                  (unsigned long)expected);
    return true;
}

Status instance_no_variables(Instance *instance, const char *type, size_t count)
{
    if (count == 0) {
        return STATUS_OK;
    }
    return instance_tell(instance, STATUS_ERROR, "%lu variables of type %s asked for, but there are none of this type",
                         (unsigned long)count, type);
}

static bool is_finite(double value)
{
    return fabs(value) <= DBL_MAX; /* not the macro, which warns of conversions on some platforms */
}

static Status not_finite(Instance *instance, const char *argument, double value)
{
    return instance_tell(instance, STATUS_ERROR, "argument `%s`: %g is not finite", argument, value);
}

/* ---- Domain of validity ---- */

/* Distance of a value from the column's range, zero inside, relative to the width of the range. */
static double column_distance(const Column *column, double value)
{
    const double below = (least_valid(column, value) - value) / column->width;
    const double above = (value - largest_valid(column, value)) / column->width;
    const double outside = below > above ? below : above;
    return outside > 0.0 ? outside : 0.0;
}

static bool contains(const Column *column, double value)
{
    const double margin = TOLERANCE * column->width;
    return least_valid(column, value) - margin <= value && value <= largest_valid(column, value) + margin;
}

/* How far a point is from the domain, zero inside, and the only derivative of that which is not zero. */
typedef struct {
    double distance;
    size_t column;
    double slope;
} Outside;

/* Distance from the column's range that is farthest; of several from the last. */
static Outside outside_ranges(const Instance *instance)
{
    Outside farthest = {0.0, 0, 0.0};
    for (size_t i = 0; i < NAMED_COUNT; i++) {
        const Column *column = &model_columns[i];
        const double value = instance->now.columns[i];
        const double found = column_distance(column, value);
        if (found >= farthest.distance) {
            const double above = value > largest_valid(column, value) ? 1.0 / column->width : 0.0;
            farthest.distance = found;
            farthest.column = i;
            farthest.slope = value < least_valid(column, value) ? -1.0 / column->width : above;
        }
    }
    return farthest;
}

#if MODEL_HAS_COVER
/* Distance from the cube around one of the centres, negative inside; or one that is not below `enough`. */
static Outside outside_cube(const Instance *instance, size_t centre, double enough)
{
    const float *at = &model_centres[centre * COVER_COLUMN_COUNT];
    Outside farthest = {-model_cover_radius, model_cover_columns[0], 0.0};
    for (size_t i = 0; i < COVER_COLUMN_COUNT && farthest.distance < enough; i++) {
        const size_t index = model_cover_columns[i];
        const Column *column = &model_columns[index];
        const double off = (instance->now.columns[index] - column->min) / column->width - (double)at[i];
        const double distance = fabs(off) - model_cover_radius;
        if (distance > farthest.distance) {
            farthest.distance = distance;
            farthest.column = index;
            farthest.slope = (off > 0.0 ? 1.0 : -1.0) / column->width;
        }
    }
    return farthest;
}

/*
 * Distance from the cube that the point is in, up to a tolerance, or the nearest one, and which one that is. A simulation
 * stays near one centre for a while, so the search begins at that one.
 */
static Outside outside_cover(const Instance *instance, double tolerance, size_t *centre)
{
    Outside nearest = outside_cube(instance, *centre, HUGE_VAL);
    for (size_t i = 0; i < COVER_COUNT && nearest.distance > tolerance; i++) {
        const Outside found = outside_cube(instance, i, nearest.distance);
        if (found.distance < nearest.distance) {
            nearest = found;
            *centre = i;
        }
    }
    return nearest;
}
#endif

/* `centre`: where the search for near data begins. The distance does not depend on it. */
static Outside outside(const Instance *instance, size_t centre)
{
    Outside farthest = outside_ranges(instance);
#if MODEL_HAS_COVER
    const Outside of_data = outside_cover(instance, 0.0, &centre);
    if (of_data.distance > farthest.distance) {
        farthest = of_data;
    }
#else
    (void)centre;
#endif
#if MODEL_HAS_SUPPORT
    /* it follows from what was before */
    if (instance->now.columns[MEMORY_DISTANCE] > farthest.distance) {
        farthest.distance = instance->now.columns[MEMORY_DISTANCE];
        farthest.slope = 0.0;
    }
#endif
    if (!(farthest.distance < DBL_MAX)) {
        farthest.distance = DBL_MAX;
    }
    return farthest;
}

static bool is_in_ranges(const Instance *instance)
{
    for (size_t i = 0; i < NAMED_COUNT; i++) {
        if (!contains(&model_columns[i], instance->now.columns[i])) {
            return false;
        }
    }
    return true;
}

/* Whether there are training data near the point; true if nothing is known about that. */
static bool is_near_data(const Instance *instance, size_t *centre)
{
#if MODEL_HAS_SUPPORT
    if (instance->now.columns[MEMORY_DISTANCE] > TOLERANCE) {
        return false;
    }
#endif
#if MODEL_HAS_COVER
    return outside_cover(instance, TOLERANCE, centre).distance <= TOLERANCE;
#else
    (void)instance;
    (void)centre;
    return true;
#endif
}

/*
 * Whether times and inputs are those a solver tries. They may lie outside the domain, also past the stop time, and many
 * a solver takes any answer but OK for a failure: what counts is a point that it accepts.
 */
static bool is_trial(const Instance *instance)
{
    return instance->now.state == STATE_CONTINUOUS_TIME;
}

static bool time_is_column(void)
{
    for (size_t i = 0; i < INPUT_COUNT; i++) {
        if (model_columns[i].role == ROLE_TIME) {
            return true;
        }
    }
    return false;
}

/*
 * Whether a value at this time is another than the one the run began with. If the time is an input of the network, its
 * outputs are those of a run in which nothing changes.
 */
static bool is_changed(const Instance *instance, size_t index, double value, double time)
{
    return model_columns[index].role != ROLE_TIME && time > instance->now.start_time &&
           !(value == instance->now.at_start[index]) && time_is_column();
}

/* Where the value of a column may be, in words. A list that is too long for a message is cut short. */
static void describe_valid(const Column *column, char text[VALID_SIZE])
{
    if (column->value_count == 0) {
        snprintf(text, VALID_SIZE, "the training range from %.10g to %.10g", column->min, column->max);
        return;
    }
    size_t length = (size_t)snprintf(text, VALID_SIZE, "the trained values");
    for (size_t i = 0; i < column->value_count && length < VALID_SIZE; i++) {
        const char *comma = i == 0 ? "" : ",";
        length += (size_t)snprintf(text + length, VALID_SIZE - length, "%s %.10g", comma, column->values[i]);
    }
}

/* Whether the policy forbids a value at this time; the host is told, with the given status. */
static bool forbids(Instance *instance, size_t index, double value, double time, Policy policy, Status status)
{
    const Column *column = &model_columns[index];
    if (policy != POLICY_ERROR) {
        return false;
    }
    if (!contains(column, value)) {
        char valid[VALID_SIZE];
        describe_valid(column, valid);
        instance_tell(instance, status, "variable `%.100s`: %.10g is outside %s, and domain_policy is 2", column->name,
                      value, valid);
        return true;
    }
    if (is_changed(instance, index, value, time)) {
        instance_tell(instance, status,
                      "variable `%.100s`: %.10g instead of %.10g as at the start of the run, and domain_policy is 2",
                      column->name, value, instance->now.at_start[index]);
        return true;
    }
    return false;
}

/* The same for all values as they are; the time counts once it is known. */
static bool forbids_point(Instance *instance, Policy policy)
{
    for (size_t i = 0; i < NAMED_COUNT; i++) {
        const bool known = model_columns[i].role != ROLE_TIME || instance->now.experiment;
        if (known && forbids(instance, i, instance->now.columns[i], instance->now.time, policy, STATUS_ERROR)) {
            return true;
        }
    }
    if (policy == POLICY_ERROR && instance->now.changed) {
        instance_tell(instance, STATUS_ERROR,
                      "inputs or parameters have been changed during the run, which domain_policy 2 forbids");
        return true;
    }
    return false;
}

/* Nothing can be clamped here, so this is said whatever the policy. */
static void note_change(Instance *instance, size_t index)
{
    instance->now.changed = true;
    if (instance->warned_of_change) {
        return;
    }
    instance->warned_of_change = true;
    instance_tell(instance, STATUS_WARNING,
                  "variable `%.100s`: changed from %.10g to %.10g during the run; outputs are those of a run "
                  "that has had %.10g since its start (said once a run)",
                  model_columns[index].name, instance->now.at_start[index], instance->now.columns[index],
                  instance->now.columns[index]);
}

/* The first call that leaves the domain logs a warning; those after it do not, as a message a step would be a flood. */
static void note_value(Instance *instance, size_t index)
{
    const Column *column = &model_columns[index];
    const double value = instance->now.columns[index];
    if (is_changed(instance, index, value, instance->now.time)) {
        note_change(instance, index);
    }
    if (instance->now.policy != POLICY_WARN || instance->warned[index] || contains(column, value)) {
        return;
    }
    instance->warned[index] = true;
    char valid[VALID_SIZE];
    describe_valid(column, valid);
    instance_tell(instance, STATUS_WARNING, "variable `%.100s`: %.10g is outside %s; outputs are %s (said once a run)",
                  column->name, value, valid, column->value_count > 0 ? "those of the nearest" : "extrapolated");
}

/*
 * Whether there are training data near the inputs. This concerns all of them together, so it is asked where they are used
 * and not where they are set, one after the other. What is outside its range is another matter.
 */
static Status note_data(Instance *instance, Status refused)
{
    const bool is_silent = instance->now.policy == POLICY_CLAMP || instance->warned_of_data;
    const bool knows_data = MODEL_HAS_COVER || MODEL_HAS_SUPPORT;
    if (is_silent || !knows_data || !is_in_ranges(instance) || is_near_data(instance, &instance->centre)) {
        return STATUS_OK;
    }
    const double distance = outside(instance, instance->centre).distance;
    if (instance->now.policy == POLICY_ERROR) {
        return instance_tell(instance, refused,
                             "the inputs are in their ranges, but %.3f of the ranges away from where training data are "
                             "near, and domain_policy is 2",
                             distance);
    }
    instance->warned_of_data = true;
    instance_tell(instance, STATUS_WARNING,
                  "the inputs are in their ranges, but %.3f of the ranges away from where training data are near; "
                  "outputs are extrapolated (said once a run)",
                  distance);
    return STATUS_OK;
}

/* States and what is remembered are what they are: they cannot be clamped. */
static void update_point(Instance *instance)
{
    const bool clamp = instance->now.policy == POLICY_CLAMP;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        const double value = instance->now.columns[i];
        instance->point[i] = clamp && i < INPUT_COUNT ? clamped(&model_columns[i], value) : value;
    }
}

/* A solver tries again with a smaller step. FMI 2.0 has Discard for reading variables in model exchange only. */
static Status not_computable(const Instance *instance)
{
    const bool discards = instance->fmi_version == 3 || instance->interface == MODEL_EXCHANGE;
    return discards ? STATUS_DISCARD : STATUS_ERROR;
}

/* Whether all values are finite, as those of a network are at every finite point; the host is told, with the status. */
static Status check_computed(Instance *instance, const double values[], size_t count, Status refused)
{
    for (size_t i = 0; MODEL_GOES_ON && i < count; i++) {
        if (!is_finite(values[i])) {
            return instance_tell(instance, refused,
                                 "the equations have no finite solution in this state: a formula is not defined there, a "
                                 "mass matrix is not positive definite, or a value is too large");
        }
    }
    return STATUS_OK;
}

/* The same of derivatives, which FMI 2.0 has no Discard for. */
static Status check_derivatives(Instance *instance, const double values[], size_t count)
{
    return check_computed(instance, values, count, instance->fmi_version == 2 ? STATUS_ERROR : STATUS_DISCARD);
}

static Status update_results(Instance *instance)
{
    if (!instance->stale) {
        return STATUS_OK;
    }
    update_point(instance);
    model_evaluate(&instance->scratch, instance->point, instance->results);
    const Status status = check_computed(instance, instance->results, RESULT_COUNT, not_computable(instance));
    instance->stale = status != STATUS_OK;
    return status;
}

/* ---- Continuous states ---- */

/* Whether the states are what the parameters for the start say. */
static bool is_starting(const Instance *instance)
{
    return instance->now.state == STATE_INSTANTIATED || instance->now.state == STATE_INITIALIZATION;
}

/* Gives the states, or what is remembered, their values at the start, until the simulation runs. */
static void initialize_states(Instance *instance)
{
#if MODEL_GOES_ON
    if (is_starting(instance)) {
        model_start(instance->now.columns);
    }
#else
    (void)instance;
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
    const Status status = update_results(instance);
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
/* A state that no motion leads to, so many seconds after the beginning of a step; negative if it is no step's. */
static Status tell_implausible(Instance *instance, Status status, size_t state, double value, double after)
{
    const Column *column = &model_columns[INPUT_COUNT + state];
    char when[VALID_SIZE] = "";
    char valid[VALID_SIZE] = "all numbers";
    if (is_finite(column->min)) {
        describe_valid(column, valid);
    }
    if (after >= 0.0) {
        snprintf(when, VALID_SIZE, "%.10g s after the beginning of the step, ", after);
    }
    return instance_tell(instance, status,
                         "%sstate `%.100s` is %.10g, which is not plausible: expected %s, and at most %.10g in "
                         "magnitude; the motion diverges",
                         when, column->name, value, valid, model_scales[state].limit);
}
#endif

#if MODEL_GOES_ON
/*
 * Integrates the states over a communication step that ends at `time`, or goes on from sample to sample. Inputs follow
 * the derivatives the host gave.
 */
static Status advance_states(Instance *instance, double time, double size, Status refused)
{
    Snapshot *now = &instance->now;
#if MODEL_HAS_STATES
    /* those of results that were computed here */
    const double *derivatives = instance->stale ? NULL : instance->results + OUTPUT_COUNT;
#else
    const double *derivatives = NULL;
#endif
    const Step step = {size, now->tolerance, derivatives, now->rates[0], now->rates[1], now->policy == POLICY_CLAMP};
    Failure failure = {0.0, 0, 0.0};
    update_point(instance);
    /* whatever comes of it, the point is not that of the results any more */
    instance->stale = true;
    for (size_t i = 0; i < INPUT_COUNT; i++) {
        if (model_columns[i].role == ROLE_INPUT) {
            instance->point[i] = now->columns[i]; /* clamped on the way */
        }
    }
    switch (model_advance(&instance->scratch, instance->point, &step, &failure)) {
    case ADVANCE_DONE:
        break;
    case ADVANCE_NOT_FINITE:
        return instance_tell(instance, refused,
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
        return instance_tell(instance, refused,
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
        if (forbids(instance, i, instance->point[i], time, now->policy, refused)) {
            return refused;
        }
    }
    for (size_t i = INPUT_COUNT; i < COLUMN_COUNT; i++) {
        now->columns[i] = instance->point[i];
    }
    for (size_t i = INPUT_COUNT; i < NAMED_COUNT; i++) {
        note_value(instance, i);
    }
    return STATUS_OK;
}
#endif

/* ---- Time ---- */

static Status set_time(Instance *instance, double time, Status refused)
{
    for (size_t i = 0; i < INPUT_COUNT; i++) {
        if (model_columns[i].role != ROLE_TIME) {
            continue;
        }
        if (!is_trial(instance) && forbids(instance, i, time, time, instance->now.policy, refused)) {
            return refused;
        }
        instance->now.columns[i] = time;
        instance->stale = true;
        if (!is_trial(instance)) {
            note_value(instance, i);
        }
    }
    instance->now.time = time;
    return STATUS_OK;
}

/* An input that follows the derivatives the host gave, `size` later; infinite polynomials stay where they are. */
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
            forbids(instance, i, extrapolated(instance, i, size), instance->now.time + size, instance->now.policy,
                    status)) {
            return true;
        }
    }
    return false;
}

static void advance_inputs(Instance *instance, double size)
{
    for (size_t i = 0; i < INPUT_COUNT; i++) {
        if (model_columns[i].role == ROLE_INPUT) {
            instance->now.columns[i] = extrapolated(instance, i, size);
            instance->now.rates[0][i] += size * instance->now.rates[1][i];
            instance->stale = true;
            note_value(instance, i);
        }
    }
}

/* FMI 2.0 has Discard for a part of the step that was computed, FMI 3.0 for a step that may be tried again. */
static Status refusal_of_step(const Instance *instance)
{
    return instance->fmi_version == 2 ? STATUS_ERROR : STATUS_DISCARD;
}

Status instance_check_step(Instance *instance, double from, double size)
{
    const double tolerance = 1e-6 * size + 1e-9 * fabs(from);
    const double time = from + size;
    const Status refused = refusal_of_step(instance);
    if (!is_finite(from)) {
        return not_finite(instance, "currentCommunicationPoint", from);
    }
    if (!is_finite(size)) {
        return not_finite(instance, "communicationStepSize", size);
    }
    if (size < 0.0) {
        return instance_tell(instance, STATUS_ERROR, "communication step size %.10g is negative", size);
    }
    if (fabs(from - instance->now.time) > tolerance) {
        return instance_tell(instance, STATUS_ERROR,
                             "current communication point is %.17g, expected %.17g, where the last step ended", from,
                             instance->now.time);
    }
    if (!is_finite(time)) {
        return not_finite(instance, "currentCommunicationPoint + communicationStepSize", time);
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
    status = note_data(instance, refused);
    if (status != STATUS_OK) {
        return status;
    }
#if MODEL_GOES_ON
    status = advance_states(instance, time, size, refused);
    if (status != STATUS_OK) {
        return status;
    }
#endif
    status = set_time(instance, time, refused);
    if (status == STATUS_OK) {
        advance_inputs(instance, size);
    }
    return status;
}

double instance_updates(double size)
{
#if MODEL_HAS_STATES
    const double steps = ceil(size / model_solver_step * (1.0 - 1e-9)); /* as in states.c */
    /* too many are refused by the solver */
    return steps >= 1.0 && steps <= MAX_STEPS ? steps : 1.0;
#else
    (void)size;
    return 1.0;
#endif
}

Status instance_set_solver_time(Instance *instance, double time)
{
    const double earliest = instance->now.earliest;
    const double magnitude = fabs(earliest) > model_time_step ? fabs(earliest) : model_time_step;
    if (!is_finite(time)) {
        return not_finite(instance, "time", time);
    }
    if (time < earliest - 1e-9 * magnitude) {
        return instance_tell(instance, STATUS_ERROR, "time %.17g is before %.17g, the start time or the last event",
                             time, earliest);
    }
    return set_time(instance, time, STATUS_ERROR);
}

Status instance_accept_point(Instance *instance)
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
    if (forbids_point(instance, instance->now.policy)) {
        return STATUS_ERROR;
    }
    const Status status = note_data(instance, STATUS_ERROR);
    for (size_t i = 0; i < NAMED_COUNT && status == STATUS_OK; i++) {
        note_value(instance, i);
    }
    return status;
}

/* ---- Modes ---- */

static void forget_warnings(Instance *instance)
{
    memset(instance->warned, 0, sizeof instance->warned);
    instance->warned_of_change = false;
    instance->warned_of_data = false;
}

Status instance_set_up_experiment(Instance *instance, bool tolerance_defined, double tolerance, double start,
                                  bool stop_defined, double stop)
{
    if (!is_finite(start)) {
        return not_finite(instance, "startTime", start);
    }
    if (tolerance_defined && !(is_finite(tolerance) && tolerance >= 0.0)) {
        return instance_tell(instance, STATUS_ERROR, "tolerance %g is negative or not finite", tolerance);
    }
    if (stop_defined && !is_finite(stop)) {
        return not_finite(instance, "stopTime", stop);
    }
    if (stop_defined && stop < start) { /* a run of no length is an initialization */
        return instance_tell(instance, STATUS_ERROR, "stop time %.17g is before start time %.17g", stop, start);
    }
    forget_warnings(instance);
    const Status status = set_time(instance, start, STATUS_ERROR);
    if (status != STATUS_ERROR) {
        instance->now.experiment = true;
        instance->now.start_time = start;
        instance->now.stop_time = stop_defined ? stop : HUGE_VAL;
        instance->now.earliest = start;
        instance->now.tolerance = tolerance_defined ? tolerance : 0.0;
#if MODEL_HAS_STATES
        if (instance->now.tolerance > 0.0 && instance->now.tolerance < LEAST_TOLERANCE) {
            instance_tell(instance, STATUS_OK, "the tolerance is %g: single precision has too few digits for %g",
                          LEAST_TOLERANCE, tolerance);
        }
#endif
    }
    return status;
}

Status instance_enter_initialization_mode(Instance *instance)
{
    if (!instance->now.experiment) {
        return instance_tell(instance, STATUS_ERROR,
                             "the experiment must be set up first: the start time is not known");
    }
    instance->now.state = STATE_INITIALIZATION;
    return STATUS_OK;
}

Status instance_exit_initialization_mode(Instance *instance)
{
    const bool event = instance->interface == MODEL_EXCHANGE || instance->event_mode;
    const Status status = note_data(instance, STATUS_ERROR);
    if (status != STATUS_ERROR) {
        instance->now.state = event ? STATE_EVENT : STATE_STEP;
    }
    return status;
}

Status instance_enter_event_mode(Instance *instance)
{
    if (instance->interface == CO_SIMULATION && !instance->event_mode) {
        return instance_tell(instance, STATUS_ERROR, "the instance was made with eventModeUsed = false");
    }
    const Status status = instance_accept_point(instance);
    if (status != STATUS_ERROR) {
        instance->now.earliest = instance->now.time;
        instance->now.state = STATE_EVENT;
    }
    return status;
}

void instance_reset(Instance *instance)
{
    Snapshot *now = &instance->now;
    now->state = STATE_INSTANTIATED;
    now->experiment = false;
    now->policy = POLICY_WARN;
    now->changed = false;
    now->time = 0.0;
    now->start_time = 0.0;
    now->stop_time = HUGE_VAL;
    now->earliest = 0.0;
    now->tolerance = 0.0;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        now->columns[i] = i < INPUT_COUNT && model_columns[i].role != ROLE_TIME ? model_columns[i].start : 0.0;
        now->rates[0][i] = 0.0;
        now->rates[1][i] = 0.0;
    }
    initialize_states(instance);
    memcpy(now->at_start, now->columns, sizeof now->at_start);
    forget_warnings(instance);
    instance->stale = true;
}

/* ---- Values ---- */

static bool exists(const Instance *instance, uint32_t reference)
{
    return reference < VARIABLE_COUNT && model_variables[reference].quantity != VARIABLE_ARRAY &&
           (instance->fmi_version == 3 || !model_variables[reference].only_fmi3);
}

static bool is(const Instance *instance, uint32_t reference, Quantity quantity)
{
    return exists(instance, reference) && model_variables[reference].quantity == quantity;
}

static uint32_t last_reference(const Instance *instance)
{
    uint32_t last = VARIABLE_COUNT - 1;
    while (!exists(instance, last)) {
        last--;
    }
    return last;
}

/* Name of a variable that exists. */
static const char *variable_name(uint32_t reference)
{
    return model_variables[reference].name;
}

static const char *variable_type(uint32_t reference)
{
    switch (model_variables[reference].quantity) {
    case VARIABLE_DOMAIN_POLICY:
        return "integer";
    case VARIABLE_IN_DOMAIN:
        return "Boolean";
    default:
        return "real";
    }
}

/* Tells why a reference is none of the type asked for. */
static Status wrong_reference(Instance *instance, uint32_t reference, const char *asked)
{
    if (reference > last_reference(instance)) {
        return instance_tell(instance, STATUS_ERROR, "value reference %lu is unknown, expected at most %lu",
                             (unsigned long)reference, (unsigned long)last_reference(instance));
    }
    if (!exists(instance, reference)) {
        return instance_tell(instance, STATUS_ERROR, "value reference %lu is unknown: it is kept for a variable that this FMU does not have",
                             (unsigned long)reference);
    }
    return instance_tell(instance, STATUS_ERROR, "variable `%.100s` (value reference %lu) is of type %s, not %s",
                         variable_name(reference), (unsigned long)reference, variable_type(reference), asked);
}

static Status cannot_set(Instance *instance, uint32_t reference, const char *what)
{
    return instance_tell(instance, STATUS_ERROR, "variable `%.100s` (value reference %lu) is %s and cannot be set",
                         variable_name(reference), (unsigned long)reference, what);
}

/* Where a variable's value is among outputs and, after them, derivatives of states, if it is one. */
static bool is_result(const Instance *instance, uint32_t reference, size_t *result)
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

/* An error bound and its derivative with respect to the time. */
typedef struct {
    double value;
    double rate;
} Bound;

static Bound bound(const Instance *instance, size_t output)
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

/* Before the initialization FMI 3.0 lets start values be read, and FMI 2.0 nothing. The host is told if there is none. */
static Status check_readable(Instance *instance, uint32_t reference)
{
    const Variable *variable = &model_variables[reference];
    const bool has_start =
        (variable->quantity == VARIABLE_COLUMN && model_columns[variable->index].role != ROLE_TIME) ||
        (variable->quantity == VARIABLE_BOUND && BOUND_TIME_COUNT <= 1) || variable->quantity == VARIABLE_DOMAIN_POLICY;
    if (instance->now.state != STATE_INSTANTIATED || has_start) {
        return STATUS_OK;
    }
    return instance_tell(instance, STATUS_ERROR,
                         "variable `%.100s` (value reference %lu) has no start value: it can be read from "
                         "Initialization Mode on",
                         variable_name(reference), (unsigned long)reference);
}

/* The value of a real variable that exists; results are up to date. */
static double value_of(const Instance *instance, uint32_t reference)
{
    const Variable *variable = &model_variables[reference];
    switch (variable->quantity) {
    case VARIABLE_OUTPUT:
        return instance->results[variable->index];
    case VARIABLE_DERIVATIVE:
        return instance->results[OUTPUT_COUNT + variable->index];
    case VARIABLE_COLUMN:
        return instance->now.columns[variable->index];
    case VARIABLE_STATE:
        return instance->now.columns[INPUT_COUNT + variable->index];
    case VARIABLE_DOMAIN_DISTANCE:
        return outside(instance, instance->centre).distance;
    case VARIABLE_BOUND:
        return bound(instance, variable->index).value;
    default:
        return instance->now.time;
    }
}

Status instance_get_real(Instance *instance, const uint32_t references[], size_t count, double values[])
{
    bool of_results = false;
    for (size_t i = 0; i < count; i++) {
        size_t result = 0;
        if (!exists(instance, references[i]) || is(instance, references[i], VARIABLE_DOMAIN_POLICY) ||
            is(instance, references[i], VARIABLE_IN_DOMAIN)) {
            return wrong_reference(instance, references[i], "real");
        }
        if (check_readable(instance, references[i]) != STATUS_OK) {
            return STATUS_ERROR;
        }
        of_results = of_results || is_result(instance, references[i], &result);
    }
    const Status status = of_results ? update_results(instance) : STATUS_OK;
    for (size_t i = 0; i < count && status == STATUS_OK; i++) {
        values[i] = value_of(instance, references[i]);
    }
    return status;
}

Status instance_get_integer(Instance *instance, const uint32_t references[], size_t count, int32_t values[])
{
    for (size_t i = 0; i < count; i++) {
        if (!is(instance, references[i], VARIABLE_DOMAIN_POLICY)) {
            return wrong_reference(instance, references[i], "integer");
        }
    }
    for (size_t i = 0; i < count; i++) {
        values[i] = (int32_t)instance->now.policy;
    }
    return STATUS_OK;
}

Status instance_get_boolean(Instance *instance, const uint32_t references[], size_t count, bool *value)
{
    for (size_t i = 0; i < count; i++) {
        if (!is(instance, references[i], VARIABLE_IN_DOMAIN)) {
            return wrong_reference(instance, references[i], "Boolean");
        }
        if (check_readable(instance, references[i]) != STATUS_OK) {
            return STATUS_ERROR;
        }
    }
    const Snapshot *now = &instance->now;
    size_t centre = instance->centre;
    *value = !now->changed && is_in_ranges(instance) && is_near_data(instance, &centre);
    for (size_t i = 0; i < NAMED_COUNT; i++) {
        *value = *value && !is_changed(instance, i, now->columns[i], now->time);
    }
    return STATUS_OK;
}

/* Parameters: fixed ones before the simulation starts, tunable ones also between steps and at events. */
static bool parameter_is_settable(const Instance *instance, bool tunable)
{
    const unsigned states = STATE_INSTANTIATED | STATE_INITIALIZATION | (tunable ? STATE_EVENT | STATE_STEP : 0u);
    return (states & (unsigned)instance->now.state) != 0;
}

static Status check_parameter(Instance *instance, uint32_t reference, bool tunable)
{
    if (parameter_is_settable(instance, tunable)) {
        return STATUS_OK;
    }
    return instance_tell(instance, STATUS_ERROR,
                         "parameter `%.100s` (value reference %lu) is %s and cannot be set in state `%s`",
                         variable_name(reference), (unsigned long)reference, tunable ? "tunable" : "fixed",
                         state_name(instance->now.state));
}

static Status check_settable(Instance *instance, uint32_t reference)
{
    if (is(instance, reference, VARIABLE_OUTPUT) || is(instance, reference, VARIABLE_DERIVATIVE) ||
        is(instance, reference, VARIABLE_DOMAIN_DISTANCE) || is(instance, reference, VARIABLE_BOUND)) {
        return cannot_set(instance, reference, "an output");
    }
    if (is(instance, reference, VARIABLE_STATE) && is_trial(instance)) {
        return STATUS_OK; /* in both standards, beside fmi3SetContinuousStates */
    }
    if (is(instance, reference, VARIABLE_STATE)) {
        return instance_tell(instance, STATUS_ERROR,
                             "variable `%.100s` (value reference %lu) is a state and cannot be set: set parameter "
                             "`%.100s_start` before the simulation runs, or the state in Continuous-Time Mode",
                             variable_name(reference), (unsigned long)reference, variable_name(reference));
    }
    if (is(instance, reference, VARIABLE_TIME)) {
        return cannot_set(instance, reference, "the independent variable");
    }
    if (!is(instance, reference, VARIABLE_COLUMN)) {
        return wrong_reference(instance, reference, "real");
    }
    switch (model_columns[reference].role) {
    case ROLE_TIME:
        return cannot_set(instance, reference, "the independent variable");
    case ROLE_INPUT:
        return STATUS_OK;
    default:
        return check_parameter(instance, reference, model_columns[reference].role == ROLE_TUNABLE_PARAMETER);
    }
}

/* The column of a variable that may be set: of an input, a parameter or a state. */
static size_t settable_column(const Instance *instance, uint32_t reference)
{
    const size_t index = model_variables[reference].index;
    return is(instance, reference, VARIABLE_STATE) ? INPUT_COUNT + index : index;
}

Status instance_set_real(Instance *instance, const uint32_t references[], size_t count, const double values[])
{
    Snapshot *now = &instance->now;
    for (size_t i = 0; i < count; i++) {
        if (check_settable(instance, references[i]) != STATUS_OK) {
            return STATUS_ERROR;
        }
        if (!is_finite(values[i])) {
            return instance_tell(instance, is_trial(instance) ? STATUS_DISCARD : STATUS_ERROR,
                                 "variable `%.100s` (value reference %lu): %g is not finite",
                                 variable_name(references[i]), (unsigned long)references[i], values[i]);
        }
        if (!is_trial(instance) && forbids(instance, settable_column(instance, references[i]), values[i], now->time,
                                           now->policy, STATUS_ERROR)) {
            return STATUS_ERROR;
        }
    }
    for (size_t i = 0; i < count; i++) {
        const size_t column = settable_column(instance, references[i]);
        now->columns[column] = values[i];
        if (now->time <= now->start_time) {
            now->at_start[column] = values[i];
        }
        instance->stale = true;
        if (!is_trial(instance)) {
            note_value(instance, column);
        }
    }
    initialize_states(instance);
    return STATUS_OK;
}

/* Sets domain_policy, unless a value is outside already that it would forbid. */
static Status set_policy(Instance *instance, Policy policy)
{
    if (forbids_point(instance, policy)) {
        return STATUS_ERROR;
    }
    instance->now.policy = policy;
    instance->stale = true;
    return STATUS_OK;
}

Status instance_set_integer(Instance *instance, const uint32_t references[], size_t count, const int32_t values[])
{
    for (size_t i = 0; i < count; i++) {
        if (!is(instance, references[i], VARIABLE_DOMAIN_POLICY)) {
            return wrong_reference(instance, references[i], "integer");
        }
        if (check_parameter(instance, references[i], true) != STATUS_OK) {
            return STATUS_ERROR;
        }
        if (values[i] < POLICY_WARN || values[i] > POLICY_ERROR) {
            return instance_tell(instance, STATUS_ERROR,
                                 "parameter `domain_policy`: %ld, expected 0 (warn), 1 (clamp) or 2 (error)",
                                 (long)values[i]);
        }
    }
    return count == 0 ? STATUS_OK : set_policy(instance, (Policy)values[count - 1]);
}

Status instance_set_boolean(Instance *instance, const uint32_t references[], size_t count)
{
    if (count == 0) {
        return STATUS_OK;
    }
    if (!is(instance, references[0], VARIABLE_IN_DOMAIN)) {
        return wrong_reference(instance, references[0], "Boolean");
    }
    return cannot_set(instance, references[0], "an output");
}

Status instance_count_dependencies(Instance *instance, uint32_t reference, size_t *count)
{
    if (!exists(instance, reference)) {
        return wrong_reference(instance, reference, "");
    }
    size_t result = 0;
    *count = 0;
    if (is_result(instance, reference, &result)) {
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
    return (uint32_t)(i < INPUT_COUNT ? i : OUTPUT_COUNT + i);
}

/* ---- Derivatives ---- */

/* The column of a known; none, which is COLUMN_COUNT, for a time that is no column. */
static size_t column_of(const Instance *instance, uint32_t known)
{
    const size_t index = model_variables[known].index;
    if (is(instance, known, VARIABLE_STATE)) {
        return INPUT_COUNT + index;
    }
    if (!is(instance, known, VARIABLE_COLUMN)) {
        return COLUMN_COUNT;
    }
    if (model_columns[index].role != ROLE_START || !is_starting(instance)) {
        return index;
    }
    /* until the simulation runs, the states are what these parameters are */
    size_t state = INPUT_COUNT;
    for (size_t i = 0; i < index; i++) {
        state += model_columns[i].role == ROLE_START ? 1 : 0;
    }
    return state;
}

static Status check_known(Instance *instance, uint32_t reference)
{
    if (is(instance, reference, VARIABLE_COLUMN) || is(instance, reference, VARIABLE_STATE) ||
        is(instance, reference, VARIABLE_TIME)) {
        return STATUS_OK;
    }
    if (!exists(instance, reference)) {
        return wrong_reference(instance, reference, "");
    }
    return instance_tell(instance, STATUS_ERROR,
                         "variable `%.100s` (value reference %lu) is no input, parameter, state or time",
                         variable_name(reference), (unsigned long)reference);
}

static Status check_unknown(Instance *instance, uint32_t reference)
{
    size_t result = 0;
    if (is_result(instance, reference, &result) || is(instance, reference, VARIABLE_STATE) ||
        is(instance, reference, VARIABLE_DOMAIN_DISTANCE) ||
        (BOUND_TIME_COUNT > 1 && is(instance, reference, VARIABLE_BOUND))) {
        return STATUS_OK;
    }
    if (!exists(instance, reference)) {
        return wrong_reference(instance, reference, "");
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
            return not_finite(instance, "seed", seed[i]);
        }
    }
    return STATUS_OK;
}

/* A direction in which the policy clamps has no effect on the surrogate's outputs. */
static void zero_clamped(const Instance *instance, double columns[COLUMN_COUNT])
{
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        if (instance->now.policy == POLICY_CLAMP && !(instance->point[i] == instance->now.columns[i])) {
            columns[i] = 0.0;
        }
    }
}

/* The change of an unknown, given those of the results, the columns, the distance from the domain and the time. */
static double change_of(const Instance *instance, uint32_t unknown, const double results[RESULT_COUNT],
                        const double columns[COLUMN_COUNT], double distance_change, double time_change)
{
    size_t result = 0;
    if (is_result(instance, unknown, &result)) {
        return results[result];
    }
    if (is(instance, unknown, VARIABLE_STATE)) {
        return columns[INPUT_COUNT + model_variables[unknown].index];
    }
    if (is(instance, unknown, VARIABLE_BOUND)) {
        return bound(instance, model_variables[unknown].index).rate * time_change;
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
    const Outside farthest = outside(instance, 0);
    if (check_sensitivity(instance, unknowns, unknown_count, knowns, known_count, seed, known_count) != STATUS_OK) {
        return STATUS_ERROR;
    }
    for (size_t i = 0; i < known_count; i++) {
        const size_t column = column_of(instance, knowns[i]);
        if (column < COLUMN_COUNT) {
            direction[column] += seed[i];
        } else {
            of_time += seed[i];
        }
    }
    const double of_distance = farthest.slope * direction[farthest.column];
    update_point(instance);
    zero_clamped(instance, direction);
    model_directional(&instance->scratch, instance->point, direction, derivative);
    for (size_t i = 0; i < unknown_count; i++) {
        sensitivity[i] = change_of(instance, unknowns[i], derivative, direction, of_distance, of_time);
    }
    return check_derivatives(instance, sensitivity, unknown_count);
}

Status instance_adjoint_derivative(Instance *instance, const uint32_t unknowns[], size_t unknown_count,
                                   const uint32_t knowns[], size_t known_count, const double seed[],
                                   double sensitivity[])
{
    double weights[RESULT_COUNT] = {0.0};
    double direct[COLUMN_COUNT] = {0.0}; /* of the states themselves */
    double weight_of_distance = 0.0;
    double of_time = 0.0;
    double gradient[COLUMN_COUNT];
    const Outside farthest = outside(instance, 0);
    if (check_sensitivity(instance, unknowns, unknown_count, knowns, known_count, seed, unknown_count) != STATUS_OK) {
        return STATUS_ERROR;
    }
    for (size_t i = 0; i < unknown_count; i++) {
        size_t result = 0;
        if (is_result(instance, unknowns[i], &result)) {
            weights[result] += seed[i];
        } else if (is(instance, unknowns[i], VARIABLE_STATE)) {
            direct[column_of(instance, unknowns[i])] += seed[i];
        } else if (is(instance, unknowns[i], VARIABLE_BOUND)) {
            of_time += seed[i] * bound(instance, model_variables[unknowns[i]].index).rate;
        } else {
            weight_of_distance += seed[i];
        }
    }
    update_point(instance);
    model_adjoint(&instance->scratch, instance->point, weights, gradient);
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        gradient[i] += direct[i];
    }
    zero_clamped(instance, gradient);
    gradient[farthest.column] += farthest.slope * weight_of_distance;
    for (size_t i = 0; i < known_count; i++) {
        const size_t column = column_of(instance, knowns[i]);
        sensitivity[i] = column < COLUMN_COUNT ? gradient[column] : of_time;
    }
    return check_derivatives(instance, sensitivity, known_count);
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
    const Outside farthest = outside(instance, 0);
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
    update_point(instance);
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
        /* bounds are linear in the time */
        const double of_time = order == 0 ? 1.0 : 0.0;
        values[i] = change_of(instance, references[i], derivatives[order], rates[order], of_distance[order], of_time);
    }
    return check_derivatives(instance, values, count);
}

Status instance_check_intermediate(Instance *instance, uint32_t reference)
{
    return exists(instance, reference) ? STATUS_OK : wrong_reference(instance, reference, "");
}

static Status check_input(Instance *instance, uint32_t reference)
{
    if (is(instance, reference, VARIABLE_COLUMN) && model_columns[reference].role == ROLE_INPUT) {
        return STATUS_OK;
    }
    if (!exists(instance, reference)) {
        return wrong_reference(instance, reference, "");
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
            return not_finite(instance, "value", values[i]);
        }
    }
    for (size_t i = 0; i < count; i++) {
        instance->now.rates[orders[i] - 1][references[i]] = values[i];
    }
    return STATUS_OK;
}

/* ---- State ---- */

/*
 * Serialized: magic number with the version of this layout, fingerprint; state, whether the experiment is set up,
 * policy, whether inputs or parameters were changed, a byte each; time, start time, stop time, earliest time,
 * tolerance, columns, columns at the start, first and second rates; a checksum of all before.
 * Numbers have 8 bytes and begin with the lowest.
 */
enum {
    NUMBER_SIZE = 8,
    MAGIC_SIZE = 8,
    FLAGS_SIZE = 4,
    NUMBERS = 5 + (2 + DERIVATIVE_ORDERS) * COLUMN_COUNT,
    CHECKED_SIZE = MAGIC_SIZE + NUMBER_SIZE + FLAGS_SIZE + NUMBERS * NUMBER_SIZE,
    SERIALIZED_SIZE = CHECKED_SIZE + NUMBER_SIZE
};

static const char MAGIC[MAGIC_SIZE + 1] = "metafmc\x03";

size_t snapshot_size(void)
{
    return SERIALIZED_SIZE;
}

void instance_save(const Instance *instance, Snapshot *to)
{
    *to = instance->now;
}

static Status foreign_state(Instance *instance)
{
    return instance_tell(instance, STATUS_ERROR,
                         "the state belongs to another FMU, or to another FMI version or interface of this one");
}

Status instance_restore(Instance *instance, const Snapshot *from)
{
    if (from->fingerprint != instance->now.fingerprint) {
        return foreign_state(instance);
    }
    instance->now = *from;
    instance->stale = true;
    return STATUS_OK;
}

static uint8_t *put_integer(uint8_t *to, uint64_t value)
{
    for (unsigned i = 0; i < NUMBER_SIZE; i++) {
        to[i] = (uint8_t)(value >> (8 * i) & 0xff);
    }
    return to + NUMBER_SIZE;
}

static uint64_t integer_at(const uint8_t *from)
{
    uint64_t value = 0;
    for (unsigned i = 0; i < NUMBER_SIZE; i++) {
        value |= (uint64_t)from[i] << (8 * i);
    }
    return value;
}

static uint8_t *put_reals(uint8_t *to, const double *values, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        uint64_t bits;
        memcpy(&bits, &values[i], sizeof bits);
        to = put_integer(to, bits);
    }
    return to;
}

static const uint8_t *take_reals(const uint8_t *from, double *values, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const uint64_t bits = integer_at(from);
        memcpy(&values[i], &bits, sizeof bits);
        from += NUMBER_SIZE;
    }
    return from;
}

static bool has_wrong_size(Instance *instance, size_t size)
{
    if (size == SERIALIZED_SIZE) {
        return false;
    }
    instance_tell(instance, STATUS_ERROR, "serialized state of %lu bytes, expected %lu", (unsigned long)size,
                  (unsigned long)SERIALIZED_SIZE);
    return true;
}

Status instance_serialize(Instance *instance, const Snapshot *from, uint8_t bytes[], size_t size)
{
    uint8_t *to = bytes;
    if (has_wrong_size(instance, size) || instance_lacks(instance, bytes, size, "serializedState")) {
        return STATUS_ERROR;
    }
    memcpy(to, MAGIC, MAGIC_SIZE);
    to = put_integer(to + MAGIC_SIZE, from->fingerprint);
    *to++ = (uint8_t)from->state;
    *to++ = from->experiment ? 1 : 0;
    *to++ = (uint8_t)from->policy;
    *to++ = from->changed ? 1 : 0;
    to = put_reals(to, &from->time, 1);
    to = put_reals(to, &from->start_time, 1);
    to = put_reals(to, &from->stop_time, 1);
    to = put_reals(to, &from->earliest, 1);
    to = put_reals(to, &from->tolerance, 1);
    to = put_reals(to, from->columns, COLUMN_COUNT);
    to = put_reals(to, from->at_start, COLUMN_COUNT);
    to = put_reals(to, from->rates[0], COLUMN_COUNT);
    to = put_reals(to, from->rates[1], COLUMN_COUNT);
    put_integer(to, hash(HASH_START, bytes, CHECKED_SIZE));
    return STATUS_OK;
}

static Status damaged_state(Instance *instance, const char *reason)
{
    return instance_tell(instance, STATUS_ERROR, "serialized state is damaged or foreign: %s", reason);
}

static bool is_state(unsigned number)
{
    for (unsigned state = STATE_INSTANTIATED; state <= STATE_ERROR; state *= 2) {
        if (number == state) {
            return true;
        }
    }
    return false;
}

Status instance_deserialize(Instance *instance, const uint8_t bytes[], size_t size, Snapshot *to)
{
    if (size < MAGIC_SIZE || memcmp(bytes, MAGIC, MAGIC_SIZE) != 0) {
        return damaged_state(instance, "it does not begin with the magic number and version");
    }
    if (size < MAGIC_SIZE + NUMBER_SIZE) {
        return damaged_state(instance, "it is cut short");
    }
    /* before the size, so that a state of another surrogate is called that */
    if (integer_at(bytes + MAGIC_SIZE) != instance->now.fingerprint) {
        return foreign_state(instance);
    }
    if (has_wrong_size(instance, size)) {
        return STATUS_ERROR;
    }
    if (integer_at(bytes + CHECKED_SIZE) != hash(HASH_START, bytes, CHECKED_SIZE)) {
        return damaged_state(instance, "the checksum does not match");
    }
    const uint8_t *from = bytes + MAGIC_SIZE + NUMBER_SIZE;
    if (!is_state(from[0])) {
        return damaged_state(instance, "it names no state");
    }
    if (from[2] > POLICY_ERROR) {
        return damaged_state(instance, "it names no domain policy");
    }
    to->fingerprint = instance->now.fingerprint;
    to->state = (State)from[0];
    to->experiment = from[1] != 0;
    to->policy = (Policy)from[2];
    to->changed = from[3] != 0;
    from = take_reals(from + FLAGS_SIZE, &to->time, 1);
    from = take_reals(from, &to->start_time, 1);
    from = take_reals(from, &to->stop_time, 1);
    from = take_reals(from, &to->earliest, 1);
    from = take_reals(from, &to->tolerance, 1);
    from = take_reals(from, to->columns, COLUMN_COUNT);
    from = take_reals(from, to->at_start, COLUMN_COUNT);
    from = take_reals(from, to->rates[0], COLUMN_COUNT);
    take_reals(from, to->rates[1], COLUMN_COUNT);
    return STATUS_OK;
}

#include "parts.h"
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

static const char CATEGORY_ERROR[] = "logStatusError";
static const char CATEGORY_WARNING[] = "logStatusWarning";
static const char CATEGORY_ALL[] = "logAll";

/* ---- Instances and messages ---- */

static bool is_blank(const char *text)
{
    return text == NULL || text[strspn(text, " \t\r\n\v\f")] == '\0';
}

void instance_initialize(Instance *instance, const char *function)
{
    instance->centre = 0;
    instance->function = function;
    instance->now.fingerprint = snapshot_fingerprint(instance);
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

const char *instance_state_name(State state)
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

/* Returns the states in which the instance's interface allows a call. */
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
                                       instance_state_name((State)state));
            length += (size_t)added;
        }
    }
    instance_tell(instance, STATUS_ERROR, "not allowed in state `%s`, only in %s", instance_state_name(instance->now.state),
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

/* Doubles each `#`, because hosts replace `#7#` by the name of a variable. */
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
        on = true; /* under all settings, as fmi2Error and FMI 3.0.3 require */
        category = CATEGORY_ERROR;
    } else if (status != STATUS_OK) {
        on = instance->log_warnings;
        category = CATEGORY_WARNING;
    }
    if (on) {
        instance->send(instance, status, category, message);
    }
}

static Status tell(Instance *instance, Status status, const char *format, va_list arguments)
{
    char message[MESSAGE_SIZE];
    char escaped[MESSAGE_SIZE];
    int length = snprintf(message, sizeof message, "%s: ", instance->function);
    vsnprintf(message + length, sizeof message - (size_t)length, format, arguments);
    escape(message, escaped, sizeof escaped);
    send_message(instance, status, escaped);
    return status;
}

Status instance_tell(Instance *instance, Status status, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    tell(instance, status, format, arguments);
    va_end(arguments);
    return status;
}

Status instance_end(Instance *instance, Status status, const char *format, ...)
{
    va_list arguments;
    if (status == STATUS_ERROR) {
        instance->now.state = instance->fmi_version == 2 ? STATE_ERROR : STATE_TERMINATED;
    }
    va_start(arguments, format);
    tell(instance, status, format, arguments);
    va_end(arguments);
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
    /* now with the new categories */
    for (size_t i = 0; i < given; i++) {
        if (!is_category(categories[i])) {
            /* not an error: an unknown category does not justify the end of a simulation */
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

Status instance_not_finite(Instance *instance, const char *argument, double value)
{
    return instance_tell(instance, STATUS_ERROR, "argument `%s`: %g is not finite", argument, value);
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
        return instance_not_finite(instance, "startTime", start);
    }
    if (tolerance_defined && !(is_finite(tolerance) && tolerance >= 0.0)) {
        return instance_tell(instance, STATUS_ERROR, "tolerance %g is negative or not finite", tolerance);
    }
    if (stop > 0.0 && !is_finite(stop)) {
        stop_defined = false; /* a run without an end has a stop time of infinity in some hosts */
    }
    if (stop_defined && !is_finite(stop)) {
        return instance_not_finite(instance, "stopTime", stop);
    }
    if (stop_defined && stop < start) { /* a run of zero length is an initialization */
        return instance_tell(instance, STATUS_ERROR, "stop time %.17g is before start time %.17g", stop, start);
    }
    forget_warnings(instance);
    const Status status = instance_set_time(instance, start, STATUS_ERROR);
    if (status != STATUS_ERROR) {
        instance->now.experiment = true;
        instance->now.start_time = start;
        instance->now.stop_time = stop_defined ? stop : HUGE_VAL;
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
    Status status = STATUS_OK;
    if (!instance->now.experiment) {
        status = instance_set_up_experiment(instance, false, 0.0, 0.0, false, 0.0);
    }
    if (status != STATUS_ERROR) {
        instance->now.state = STATE_INITIALIZATION;
    }
    return status;
}

Status instance_exit_initialization_mode(Instance *instance)
{
    const bool event = instance->interface == MODEL_EXCHANGE || instance->event_mode;
    const Status status = domain_note_data(instance, STATUS_ERROR);
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
    now->tolerance = 0.0;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        now->columns[i] = i < INPUT_COUNT && model_columns[i].role != ROLE_TIME ? model_columns[i].start : 0.0;
        now->rates[0][i] = 0.0;
        now->rates[1][i] = 0.0;
    }
    instance_initialize_states(instance);
    memcpy(now->at_start, now->columns, sizeof now->at_start);
    instance->trials = 0;
    instance->furthest = -HUGE_VAL;
    forget_warnings(instance);
    instance->stale = true;
}

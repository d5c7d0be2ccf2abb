/* Messages to the host: illegal calls, wrong arguments, log categories. */
#include "parts.h"
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

static const char CATEGORY_ERROR[] = "logStatusError";
static const char CATEGORY_WARNING[] = "logStatusWarning";
static const char CATEGORY_ALL[] = "logAll";

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

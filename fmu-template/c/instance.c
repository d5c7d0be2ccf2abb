#include "parts.h"
#include <math.h>
#include <string.h>

/* ---- Instances ---- */

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

Status instance_set_solver_time(Instance *instance, double time)
{
    if (!is_finite(time)) {
        return instance_not_finite(instance, "time", time);
    }
    if (instance->now.state == STATE_INSTANTIATED) {
        /* the experiment begins then */
        return instance_set_up_experiment(instance, true, instance->now.tolerance, time, true,
                                          instance->now.stop_time);
    }
    return instance_set_time(instance, time, STATUS_ERROR);
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

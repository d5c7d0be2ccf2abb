/*
 * Declarations that the parts of an instance share: messages.c, domain.c, steps.c, variables.c, derivatives.c, snapshot.c and instance.c
 * (modes). Each calls only those before it. fmi2.c and fmi3.c need instance.h only.
 */
#ifndef PARTS_H
#define PARTS_H

#include "instance.h"
#include <float.h>
#include <math.h>

static inline bool is_finite(double value)
{
    return fabs(value) <= DBL_MAX; /* not the macro, which warns of conversions on some platforms */
}

/*
 * Returns true if times and inputs are trial values of a solver. They may lie outside the domain, and past the stop
 * time: only a point that the solver accepts counts. Many solvers treat any status but OK as a failure.
 */
static inline bool is_trial(const Instance *instance)
{
    return instance->now.state == STATE_CONTINUOUS_TIME;
}

/* Returns true if the start parameters define the states. */
static inline bool is_starting(const Instance *instance)
{
    return instance->now.state == STATE_INSTANTIATED || instance->now.state == STATE_INITIALIZATION;
}

/* ---- Messages: messages.c ---- */

const char *instance_state_name(State state);

/* Refuses an argument that is NaN or infinite. */
Status instance_not_finite(Instance *instance, const char *argument, double value);

/* ---- Domain of validity: domain.c ---- */

enum { VALID_SIZE = 200 }; /* size of the text for valid values */

/* Distance of a point from the domain, zero inside, and its only nonzero derivative. */
typedef struct {
    double distance;
    size_t column;
    double slope;
} Outside;

/* Returns the distance from the domain. The search for near data begins at `centre`, which does not affect the distance. */
Outside domain_outside(const Instance *instance, size_t centre);

/* Returns the value of in_domain. */
bool domain_contains(const Instance *instance);

/* Writes the valid values of a column as text. A list that is too long for a message is truncated. */
void domain_describe(const Column *column, char text[VALID_SIZE]);

/* Returns true, after a message with the given status, if the policy forbids a value at this time. */
bool domain_forbids(Instance *instance, size_t index, double value, double time, Policy policy, Status status);

/* Returns true, after an error, if the policy forbids one of the present values. The time counts once it is known. */
bool domain_forbids_point(Instance *instance, Policy policy);

/* Warns of a value that is outside the domain, or changed, once a run: a message for each step would flood the log. */
void domain_note_value(Instance *instance, size_t index);

/*
 * Warns of inputs that are far from training data or, depending on the policy, refuses them with the given status. All
 * inputs together matter, so they are checked when they are used, not when they are set one after the other. Inputs
 * outside their ranges are checked elsewhere.
 */
Status domain_note_data(Instance *instance, Status refused);

/* ---- Variables: variables.c ---- */

static inline bool exists(const Instance *instance, uint32_t reference)
{
    return reference < REFERENCE_COUNT && model_variables[reference].quantity != VARIABLE_NONE &&
           (instance->fmi_version == 3 || !model_variables[reference].only_fmi3);
}

static inline bool is(const Instance *instance, uint32_t reference, Quantity quantity)
{
    return exists(instance, reference) && model_variables[reference].quantity == quantity;
}

/* Returns true if measured outputs are used. */
static inline bool is_measured(const Instance *instance)
{
    return MEASURED_COUNT > 0 && instance->now.columns[FIRST_MEASURED + MEASURED_COUNT] > 0.5;
}

/* Returns the column of a variable that has one: an input, a parameter, a state or a measured output. */
static inline size_t variable_column(const Instance *instance, uint32_t reference)
{
    const size_t index = model_variables[reference].index;
    if (is(instance, reference, VARIABLE_MEASURED)) {
        return FIRST_MEASURED + index;
    }
    return is(instance, reference, VARIABLE_STATE) ? INPUT_COUNT + index : index;
}

/* Returns the name of a variable that exists. */
static inline const char *variable_name(uint32_t reference)
{
    return model_variables[reference].name;
}

/* Reports why a reference does not have the expected type. */
Status variable_wrong(Instance *instance, uint32_t reference, const char *asked);

/* Returns true if a variable is a result, and sets its position among outputs, followed by derivatives of states. */
bool variable_is_result(const Instance *instance, uint32_t reference, size_t *result);

/* An error bound and its derivative with respect to time. */
typedef struct {
    double value;
    double rate;
} Bound;

Bound variable_bound(const Instance *instance, size_t output);

/* ---- Evaluation, states and time: steps.c ---- */

/* Updates the point from the columns. States and memory are not clamped. */
void instance_update_point(Instance *instance);

/* Updates the results from the columns. */
Status instance_update_results(Instance *instance);

/* Refuses derivatives that are not finite. */
Status instance_check_derivatives(Instance *instance, const double values[], size_t count);

/* Sets the states, or the memory, from the start parameters, until the simulation runs. */
void instance_initialize_states(Instance *instance);

/*
 * Follows a parameter that got another value after the initialization, at the start time. Start values of states are those of the states,
 * and the memory of samples follows all parameters.
 */
void instance_restart(Instance *instance, size_t column);

/* Sets the time. If the policy forbids it, reports and returns the given status. */
Status instance_set_time(Instance *instance, double time, Status refused);

/* ---- Stored states: snapshot.c ---- */

/* Returns a number that identifies surrogate, FMI version and interface. */
uint64_t snapshot_fingerprint(const Instance *instance);

#endif

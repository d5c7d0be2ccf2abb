/*
 * What the parts of an instance share: instance.c (messages and modes), domain.c, variables.c, steps.c, derivatives.c and
 * snapshot.c. fmi2.c and fmi3.c need instance.h only.
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
 * Whether times and inputs are those a solver tries. They may lie outside the domain, also past the stop time, and many
 * a solver takes any answer but OK for a failure: what counts is a point that it accepts.
 */
static inline bool is_trial(const Instance *instance)
{
    return instance->now.state == STATE_CONTINUOUS_TIME;
}

/* Whether the states are what the parameters for the start say. */
static inline bool is_starting(const Instance *instance)
{
    return instance->now.state == STATE_INSTANTIATED || instance->now.state == STATE_INITIALIZATION;
}

/* ---- Messages: instance.c ---- */

const char *instance_state_name(State state);

/* Refuses an argument that is NaN or infinite. */
Status instance_not_finite(Instance *instance, const char *argument, double value);

/* ---- Domain of validity: domain.c ---- */

enum { VALID_SIZE = 200 }; /* of the text for what is valid */

/* How far a point is from the domain, zero inside, and the only derivative of that which is not zero. */
typedef struct {
    double distance;
    size_t column;
    double slope;
} Outside;

/* `centre`: where the search for near data begins. The distance does not depend on it. */
Outside domain_outside(const Instance *instance, size_t centre);

/* The value of in_domain. */
bool domain_contains(const Instance *instance);

/* The values that are valid for a column, as text. A list that is too long for a message is cut short. */
void domain_describe(const Column *column, char text[VALID_SIZE]);

/* Returns true, after a message with the given status, if the policy forbids a value at this time. */
bool domain_forbids(Instance *instance, size_t index, double value, double time, Policy policy, Status status);

/* Returns true, after an error, if the policy forbids one of the present values; the time counts once it is known. */
bool domain_forbids_point(Instance *instance, Policy policy);

/* Warns of a value outside the domain, or of one that changed, once a run: a message for each step would be a flood. */
void domain_note_value(Instance *instance, size_t index);

/*
 * Warns of inputs that are far from training data, or refuses them with the given status, by the policy. This concerns
 * all inputs together, so it is checked where they are used and not where they are set, one after the other. Inputs
 * outside their ranges are another matter.
 */
Status domain_note_data(Instance *instance, Status refused);

/* ---- Variables: variables.c ---- */

static inline bool exists(const Instance *instance, uint32_t reference)
{
    return reference < VARIABLE_COUNT && model_variables[reference].quantity != VARIABLE_ARRAY &&
           (instance->fmi_version == 3 || !model_variables[reference].only_fmi3);
}

static inline bool is(const Instance *instance, uint32_t reference, Quantity quantity)
{
    return exists(instance, reference) && model_variables[reference].quantity == quantity;
}

/* Whether outputs are measured. */
static inline bool is_measured(const Instance *instance)
{
    return MEASURED_COUNT > 0 && instance->now.columns[FIRST_MEASURED + MEASURED_COUNT] > 0.5;
}

/* Column of a variable that has one: of an input, a parameter, a state or a measured output. */
static inline size_t variable_column(const Instance *instance, uint32_t reference)
{
    const size_t index = model_variables[reference].index;
    if (is(instance, reference, VARIABLE_MEASURED)) {
        return FIRST_MEASURED + index;
    }
    return is(instance, reference, VARIABLE_STATE) ? INPUT_COUNT + index : index;
}

/* Name of a variable that exists. */
static inline const char *variable_name(uint32_t reference)
{
    return model_variables[reference].name;
}

/* Tells why a reference is none of the type asked for. */
Status variable_wrong(Instance *instance, uint32_t reference, const char *asked);

/* Returns true if a variable is a result, and its position among outputs and, after them, derivatives of states. */
bool variable_is_result(const Instance *instance, uint32_t reference, size_t *result);

/* An error bound and its derivative with respect to the time. */
typedef struct {
    double value;
    double rate;
} Bound;

Bound variable_bound(const Instance *instance, size_t output);

/* ---- Evaluation, states and time: steps.c ---- */

/* The point becomes that of the columns; states and memory are not clamped. */
void instance_update_point(Instance *instance);

/* The results become those of the columns. */
Status instance_update_results(Instance *instance);

/* Refuses derivatives that are not finite. */
Status instance_check_derivatives(Instance *instance, const double values[], size_t count);

/* The states, or the memory, become those of the parameters for the start, until the simulation runs. */
void instance_initialize_states(Instance *instance);

/* Sets the time, unless the policy forbids it: then with the given status. */
Status instance_set_time(Instance *instance, double time, Status refused);

/* ---- Stored states: snapshot.c ---- */

/* A number of surrogate, FMI version and interface. */
uint64_t snapshot_fingerprint(const Instance *instance);

#endif

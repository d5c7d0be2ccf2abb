/*
 * FMI 2.0 with states: the crane. Its inputs are the rope's length (fixed, 1 to 2), the starts of the four states and a
 * force (-10 to 10); the trolley's position is trained from -5 to 5.
 */
#include "fmi2.h"
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { ROPE = 1, STARTS, FORCE = 6, LOAD_X = 9, LOAD_V, LOAD_A, KINETIC, STATES = 14, RATES = 18, DOMAIN_POLICY = 22 };

static int messages = 0;
static int allocations = 0;
static char last_message[MESSAGE_SIZE];

static void logger(void *environment, const char *name, fmi2Status status, const char *category, const char *format, ...)
{
    va_list arguments;
    (void)environment;
    (void)name;
    (void)status;
    (void)category;
    va_start(arguments, format);
    vsnprintf(last_message, sizeof last_message, format, arguments);
    va_end(arguments);
    messages++;
}

static void *counted(size_t count, size_t size)
{
    allocations++;
    return calloc(count, size);
}

static const fmi2CallbackFunctions callbacks = {logger, counted, free, NULL, NULL};

static void check(bool good, int line)
{
    if (!good) {
        printf("line %d: not so; last message: %s\n", line, last_message);
        exit(1);
    }
}

static void said(const char *part, int line)
{
    check(messages > 0 && strstr(last_message, part) != NULL, line);
    messages = 0;
}

static const uint32_t all[4] = {0, 1, 2, 3};

static Status set(void *c, uint32_t reference, double value)
{
    return fmi2SetReal(c, &reference, 1, &value);
}

static Status set_policy(void *c, int32_t value)
{
    const uint32_t reference = DOMAIN_POLICY;
    return fmi2SetInteger(c, &reference, 1, &value);
}

static Status get_four(void *c, uint32_t first, double values[4])
{
    const uint32_t references[4] = {first + all[0], first + all[1], first + all[2], first + all[3]};
    return fmi2GetReal(c, references, 4, values);
}

static double get(void *c, uint32_t reference)
{
    double value = NAN;
    check(fmi2GetReal(c, &reference, 1, &value) == STATUS_OK, __LINE__);
    return value;
}

static bool same(const double a[4], const double b[4])
{
    return memcmp(a, b, 4 * sizeof *a) == 0;
}

/* Swinging, with the given tolerance if it is not zero. */
static void *swinging(int kind, double tolerance)
{
    void *c = fmi2Instantiate("crane", kind, model_token, NULL, &callbacks, 0, 0);
    check(c != NULL, __LINE__);
    check(set(c, STARTS, 0.1) == STATUS_OK && set(c, STARTS + 1, 0.5) == STATUS_OK, __LINE__);
    check(set(c, STARTS + 2, -0.2) == STATUS_OK && set(c, STARTS + 3, 0.3) == STATUS_OK, __LINE__);
    check(fmi2SetupExperiment(c, tolerance > 0.0, tolerance, 0.0, 0, 0.0) == STATUS_OK, __LINE__);
    check(fmi2EnterInitializationMode(c) == STATUS_OK, __LINE__);
    return c;
}

static void *stepping(double tolerance)
{
    void *c = swinging(1, tolerance);
    check(fmi2ExitInitializationMode(c) == STATUS_OK, __LINE__);
    return c;
}

static void *solving(void)
{
    void *c = swinging(0, 0.0);
    check(fmi2ExitInitializationMode(c) == STATUS_OK && fmi2EnterContinuousTimeMode(c) == STATUS_OK, __LINE__);
    return c;
}

static void starts(void)
{
    void *c = swinging(1, 0.0);
    double states[4];
    check(get_four(c, STATES, states) == STATUS_OK && same(states, (const double[]){0.1, 0.5, -0.2, 0.3}), __LINE__);
    check(set(c, STARTS + 1, 0.7) == STATUS_OK && get(c, STATES + 1) == 0.7, __LINE__);
    check(fabs(get(c, LOAD_X) - (0.1 + 1.5 * sin(0.7))) < 1e-15, __LINE__);
    const uint32_t start = STARTS + 1;
    const uint32_t unknowns[] = {LOAD_X, STATES, STATES + 1};
    const double one = 1.0;
    double found[3];
    check(fmi2GetDirectionalDerivative(c, unknowns, 3, &start, 1, &one, found) == STATUS_OK, __LINE__);
    check(fabs(found[0] - 1.5 * cos(0.7)) < 1e-15 && found[1] == 0.0 && found[2] == 1.0, __LINE__);
    check(fmi2ExitInitializationMode(c) == STATUS_OK, __LINE__);
    check(fmi2GetDirectionalDerivative(c, unknowns, 3, &start, 1, &one, found) == STATUS_OK, __LINE__);
    check(found[0] == 0.0 && found[2] == 0.0, __LINE__); /* the run has begun */
    check(set(c, STARTS + 1, 0.8) == STATUS_OK && get(c, STATES + 1) == 0.8, __LINE__); /* no time has passed */
    check(fmi2DoStep(c, 0.0, 0.01, 1) == STATUS_OK && set(c, STARTS + 1, 0.8) == STATUS_OK, __LINE__);
    check(set(c, STARTS + 1, 0.9) == STATUS_ERROR, __LINE__);
    said("parameter `rope.angle_start` (value reference 3) is fixed and cannot be set", __LINE__);
    check(fmi2Reset(c) == STATUS_OK && fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0) == STATUS_OK, __LINE__);
    check(fmi2EnterInitializationMode(c) == STATUS_OK && get(c, STATES + 1) == 0.3, __LINE__);
    check(set(c, STATES, 1.0) == STATUS_ERROR, __LINE__);
    said("fmi2SetReal: variable `trolley.position` (value reference 14) is a state and cannot be set: set parameter "
         "`trolley.position_start` before the simulation runs, or the state in Continuous-Time Mode", __LINE__);
    fmi2Reset(c);
    check(set(c, RATES, 1.0) == STATUS_ERROR, __LINE__);
    said("is computed and cannot be set", __LINE__);
    const double tolerances[] = {-1.0, NAN, INFINITY};
    for (int i = 0; i < 3; i++) {
        fmi2Reset(c);
        check(fmi2SetupExperiment(c, 1, tolerances[i], 0.0, 0, 0.0) == STATUS_ERROR, __LINE__);
        said("is negative or not finite", __LINE__);
    }
    fmi2FreeInstance(c);
}

static void steps(void)
{
    for (int i = 0; i < 2; i++) {
        void *c = stepping(i == 0 ? 0.0 : 1e-9);
        const uint32_t force = FORCE;
        const int32_t orders[] = {1, 2};
        const double rates[] = {3.0, -4.0};
        const uint32_t forces[] = {FORCE, FORCE};
        double expected[COLUMN_COUNT] = {1.5, 0.1, 0.5, -0.2, 0.3, 2.0, 0.1, 0.5, -0.2, 0.3};
        double first[COLUMN_COUNT] = {0.0};
        double second[COLUMN_COUNT] = {0.0};
        double found[4];
        Failure failure;
        static Scratch scratch;
        first[FORCE - FIRST_REFERENCE] = rates[0];
        second[FORCE - FIRST_REFERENCE] = rates[1];
        const Step step = {0.05, i == 0 ? 0.0 : 1e-9, NULL, first, second, false};
        check(model_advance(&scratch, expected, &step, &failure) == ADVANCE_DONE, __LINE__);
        check(set(c, force, 2.0) == STATUS_OK, __LINE__);
        check(fmi2SetRealInputDerivatives(c, forces, 2, orders, rates) == STATUS_OK, __LINE__);
        check(fmi2DoStep(c, 0.0, 0.05, 1) == STATUS_OK && get_four(c, STATES, found) == STATUS_OK, __LINE__);
        check(same(found, expected + INPUT_COUNT), __LINE__);
        check(fabs(get(c, force) - (2.0 + 0.05 * (3.0 - 0.5 * 0.05 * 4.0))) < 1e-15, __LINE__);
        fmi2FreeInstance(c);
    }
}

static void solver(void)
{
    void *c = solving();
    static Scratch scratch;
    const double point[COLUMN_COUNT] = {1.5, 0.1, 0.5, -0.2, 0.3, 3.0, 0.4, 0.9, -1.2, 2.0};
    const uint32_t unknowns[] = {LOAD_X, RATES, RATES + 2};
    const uint32_t knowns[] = {STATES + 1, STATES + 2, FORCE};
    const double one = 1.0;
    double results[RESULT_COUNT];
    double found[4];
    check(fmi2GetContinuousStates(c, found, 4) == STATUS_OK, __LINE__);
    check(same(found, (const double[]){0.1, 0.5, -0.2, 0.3}), __LINE__);
    check(fmi2GetNominalsOfContinuousStates(c, found, 4) == STATUS_OK, __LINE__);
    check(same(found, (const double[]){1.0, 1.0, 1.0, 1.0}), __LINE__);
    check(fmi2GetEventIndicators(c, NULL, 0) == STATUS_OK, __LINE__);
    check(fmi2SetContinuousStates(c, point + INPUT_COUNT, 4) == STATUS_OK && set(c, FORCE, 3.0) == STATUS_OK, __LINE__);
    model_evaluate(&scratch, point, results);
    check(fmi2GetDerivatives(c, found, 4) == STATUS_OK && same(found, results + OUTPUT_COUNT), __LINE__);
    check(get_four(c, RATES, found) == STATUS_OK && same(found, results + OUTPUT_COUNT), __LINE__);
    check(get(c, LOAD_A) == results[4], __LINE__);
    for (size_t i = 0; i < 3; i++) {
        double derivative[3];
        const double mobility = 1.0 / (3.0 - cos(0.9) * cos(0.9));
        const double expected[3][3] = {{1.5 * cos(0.9), 0.0, NAN}, {0.0, 1.0, -0.3 * mobility}, {0.0, 0.0, mobility}};
        check(fmi2GetDirectionalDerivative(c, unknowns, 3, &knowns[i], 1, &one, derivative) == STATUS_OK, __LINE__);
        for (size_t k = 0; k < 3; k++) {
            check(isnan(expected[i][k]) || fabs(derivative[k] - expected[i][k]) < 1e-14, __LINE__);
        }
    }
    check(fmi2SetContinuousStates(c, found, 3) == STATUS_ERROR, __LINE__);
    said("argument `x`: 3 elements, expected 4", __LINE__);
    fmi2FreeInstance(c);
    c = solving();
    /* trial values that are not finite are discarded, and the solver continues */
    check(fmi2SetContinuousStates(c, (const double[]){0.0, NAN, 0.0, 0.0}, 4) == STATUS_DISCARD, __LINE__);
    said("is not finite; the states stay what they were", __LINE__);
    check(set(c, FORCE, INFINITY) == STATUS_DISCARD && fmi2GetContinuousStates(c, found, 4) == STATUS_OK, __LINE__);
    check(same(found, (const double[]){0.1, 0.5, -0.2, 0.3}), __LINE__);
    /* it may set a state as a variable */
    check(set(c, STATES + 2, 0.75) == STATUS_OK && fmi2GetContinuousStates(c, found, 4) == STATUS_OK, __LINE__);
    check(same(found, (const double[]){0.1, 0.5, 0.75, 0.3}), __LINE__);
    fmi2FreeInstance(c);
    c = solving();
    check(fmi2GetDerivatives(c, NULL, 4) == STATUS_ERROR, __LINE__);
    said("argument `derivatives` is a null pointer", __LINE__);
    fmi2FreeInstance(c);
    c = solving();
    const uint32_t policy = DOMAIN_POLICY;
    check(fmi2GetDirectionalDerivative(c, unknowns, 1, &policy, 1, &one, found) == STATUS_OK && found[0] == 0.0, __LINE__);
    fmi2FreeInstance(c);
    c = solving();
    check(fmi2GetDirectionalDerivative(c, knowns + 2, 1, knowns, 1, &one, found) == STATUS_ERROR, __LINE__);
    said("`force` (value reference 6) is no continuous output, state or derivative of one", __LINE__);
    fmi2FreeInstance(c);
}

/* The second derivatives of velocities, too, are exact. */
static void output_derivatives(void)
{
    void *c = stepping(0.0);
    const uint32_t force = FORCE;
    const uint32_t references[] = {LOAD_X, LOAD_X, LOAD_V, LOAD_V, STATES + 3, STATES + 3};
    const int32_t orders[] = {1, 2, 1, 2, 1, 2};
    const double rate = 5.0;
    const double size = 1e-4;
    double found[6];
    check(fmi2SetRealInputDerivatives(c, &force, 1, orders, &rate) == STATUS_OK, __LINE__);
    check(fmi2DoStep(c, 0.0, 0.1 - size, 1) == STATUS_OK, __LINE__);
    const double before = get(c, LOAD_A);
    check(fmi2DoStep(c, 0.1 - size, size, 1) == STATUS_OK, __LINE__);
    check(fmi2GetRealOutputDerivatives(c, references, 6, orders, found) == STATUS_OK, __LINE__);
    check(fabs(found[0] - get(c, LOAD_V)) < 1e-14 && fabs(found[1] - get(c, LOAD_A)) < 1e-13, __LINE__);
    check(fabs(found[2] - get(c, LOAD_A)) < 1e-13 && fabs(found[4] - get(c, RATES + 3)) < 1e-14, __LINE__);
    check(fmi2DoStep(c, 0.1, size, 1) == STATUS_OK, __LINE__);
    check(fabs(found[3] - (get(c, LOAD_A) - before) / (2.0 * size)) < 1e-5, __LINE__);
    fmi2FreeInstance(c);
}

static void saved_states(void)
{
    void *c = stepping(1e-6);
    void *other = stepping(0.0);
    void *state = NULL;
    void *copy = NULL;
    char bytes[4096];
    size_t size = 0;
    double expected[4];
    double found[4];
    check(set(c, FORCE, 2.0) == STATUS_OK && fmi2DoStep(c, 0.0, 0.1, 1) == STATUS_OK, __LINE__);
    check(fmi2GetFMUstate(c, &state) == STATUS_OK, __LINE__);
    check(fmi2SerializedFMUstateSize(c, state, &size) == STATUS_OK, __LINE__);
    check(size == 8 + 8 + 4 + 8 * (4 + 4 * 10) + 8, __LINE__);
    check(fmi2SerializeFMUstate(c, state, bytes, size) == STATUS_OK, __LINE__);
    check(fmi2DoStep(c, 0.1, 0.1, 1) == STATUS_OK && get_four(c, STATES, expected) == STATUS_OK, __LINE__);
    check(fmi2SetFMUstate(c, state) == STATUS_OK && fmi2DoStep(c, 0.1, 0.1, 1) == STATUS_OK, __LINE__);
    check(get_four(c, STATES, found) == STATUS_OK && same(found, expected), __LINE__);
    check(fmi2DeSerializeFMUstate(other, bytes, size, &copy) == STATUS_OK, __LINE__);
    check(fmi2SetFMUstate(other, copy) == STATUS_OK && fmi2DoStep(other, 0.1, 0.1, 1) == STATUS_OK, __LINE__);
    check(get_four(other, STATES, found) == STATUS_OK && same(found, expected), __LINE__); /* the tolerance, too */
    fmi2FreeFMUstate(c, &state);
    fmi2FreeFMUstate(other, &copy);
    fmi2FreeInstance(c);
    fmi2FreeInstance(other);
}

static void no_allocation(void)
{
    void *c = stepping(0.0);
    void *other = solving();
    const int before = allocations;
    const uint32_t load = LOAD_X;
    const uint32_t force = FORCE;
    const double one = 1.0;
    double found[4];
    for (int i = 0; i < 50; i++) {
        check(fmi2DoStep(c, 0.01 * i, 0.01, 1) == STATUS_OK && isfinite(get(c, LOAD_A)), __LINE__);
        check(fmi2GetDirectionalDerivative(c, &load, 1, &force, 1, &one, found) == STATUS_OK, __LINE__);
        check(fmi2GetDerivatives(other, found, 4) == STATUS_OK, __LINE__);
    }
    check(allocations == before, __LINE__);
    fmi2FreeInstance(c);
    fmi2FreeInstance(other);
}

static void domain(void)
{
    double states[4];
    double last[4];
    double time = 0.0;
    /* a trolley beyond its rail */
    void *c = stepping(0.0);
    check(set(c, FORCE, 10.0) == STATUS_OK, __LINE__);
    messages = 0;
    for (int i = 0; i < 80; i++) {
        check(fmi2DoStep(c, 0.1 * i, 0.1, 1) == STATUS_OK, __LINE__);
    }
    check(messages == 1, __LINE__); /* said once */
    said("fmi2DoStep: variable `trolley.position`: 5", __LINE__);
    check(strstr(last_message, "outside the training range from -5 to 5; outputs are extrapolated") != NULL, __LINE__);
    fmi2FreeInstance(c);
    /* policy 2 refuses it, and the state is as before */
    c = stepping(0.0);
    check(set_policy(c, 2) == STATUS_OK && set(c, FORCE, 10.0) == STATUS_OK, __LINE__);
    do {
        check(get_four(c, STATES, last) == STATUS_OK, __LINE__);
        time += 0.1;
    } while (fmi2DoStep(c, time - 0.1, 0.1, 1) == STATUS_OK);
    said("and domain_policy is 2", __LINE__);
    check(last[0] > 4.0 && last[0] <= 5.0, __LINE__);
    check(get_four(c, STATES, states) == STATUS_OK && same(states, last), __LINE__);
    fmi2FreeInstance(c);
    /* policy 1 clamps the force on the way, and no state */
    c = stepping(0.0);
    check(set(c, FORCE, 10.0) == STATUS_OK && set_policy(c, 1) == STATUS_OK, __LINE__);
    check(fmi2DoStep(c, 0.0, 0.1, 1) == STATUS_OK && get_four(c, STATES, last) == STATUS_OK, __LINE__);
    fmi2FreeInstance(c);
    c = stepping(0.0);
    check(set_policy(c, 1) == STATUS_OK && set(c, FORCE, 99.0) == STATUS_OK, __LINE__);
    check(fmi2DoStep(c, 0.0, 0.1, 1) == STATUS_OK && get_four(c, STATES, states) == STATUS_OK, __LINE__);
    check(same(states, last), __LINE__);
    fmi2FreeInstance(c);
    /* a force that is clamped does not change, whatever its rate */
    double bends[2];
    for (int i = 0; i < 2; i++) {
        const uint32_t force = FORCE;
        const uint32_t velocity = STATES + 2;
        const int32_t orders[] = {1, 2};
        const double rate = 7.0 * i;
        c = stepping(0.0);
        check(set_policy(c, 1) == STATUS_OK && set(c, FORCE, 99.0) == STATUS_OK, __LINE__);
        check(fmi2DoStep(c, 0.0, 0.1, 1) == STATUS_OK, __LINE__);
        check(fmi2SetRealInputDerivatives(c, &force, 1, orders, &rate) == STATUS_OK, __LINE__);
        check(fmi2GetRealOutputDerivatives(c, &velocity, 1, orders + 1, &bends[i]) == STATUS_OK, __LINE__);
        fmi2FreeInstance(c);
    }
    check(bends[0] == bends[1], __LINE__);
}

static void what_cannot_be_computed(void)
{
    void *c = swinging(1, 0.0);
    double rates[4];
    check(set(c, ROPE, 0.0) == STATUS_OK && fmi2ExitInitializationMode(c) == STATUS_OK, __LINE__);
    check(fmi2DoStep(c, 0.0, 0.1, 1) == STATUS_ERROR, __LINE__);
    said("the states are not finite 0.005 s after the beginning of the step: the motion diverges, or reaches a "
         "state in which the equations have no finite solution", __LINE__);
    fmi2FreeInstance(c);
    /* a solver may discard what it reads, and co-simulation not */
    for (int kind = 0; kind < 2; kind++) {
        c = swinging(kind, 0.0);
        check(set(c, ROPE, 0.0) == STATUS_OK && fmi2ExitInitializationMode(c) == STATUS_OK, __LINE__);
        check(get_four(c, RATES, rates) == (kind == 0 ? STATUS_DISCARD : STATUS_ERROR), __LINE__);
        said("fmi2GetReal: the equations have no finite solution in this state: a formula is not defined there, a mass "
             "matrix is not positive definite, or a value is too large", __LINE__);
        fmi2FreeInstance(c);
    }
    c = stepping(0.0);
    check(fmi2DoStep(c, 0.0, 1e9, 1) == STATUS_ERROR, __LINE__);
    said("communication step size 1000000000 takes more than ten million steps of the solver, expected a smaller one",
         __LINE__);
    fmi2FreeInstance(c);
}

int main(void)
{
    starts();
    steps();
    solver();
    output_derivatives();
    saved_states();
    no_allocation();
    domain();
    what_cannot_be_computed();
    return 0;
}

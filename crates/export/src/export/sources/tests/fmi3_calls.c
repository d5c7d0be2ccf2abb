/*
 * Calls the functions of FMI 3.0, as a host that knows the standard and as one that does not. The FMU has the columns
 * `length` (tunable, 0.1 to 0.2), `speed` (an input, 0 to 5), `time` (0 to 2) and two outputs.
 */
#include "fmi3.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LENGTH = 1, SPEED, TIME, ANGLE, VELOCITY, DOMAIN_POLICY, IN_DOMAIN, DISTANCE, UNKNOWN };

static int messages = 0;
static char last_message[MESSAGE_SIZE];

static void logger(void *environment, fmi3Status status, const char *category, const char *message)
{
    (void)environment;
    (void)status;
    (void)category;
    snprintf(last_message, sizeof last_message, "%s", message);
    messages++;
}

static void check(bool good, int line)
{
    if (!good) {
        printf("line %d: not so; last message: %s\n", line, last_message);
        exit(1);
    }
}

static void refused(Status status, int line)
{
    check(status == STATUS_ERROR && messages > 0, line);
    messages = 0;
}

static void *co_simulation(bool event_mode)
{
    void *made = fmi3InstantiateCoSimulation("instance", model_token, NULL, false, true, event_mode, false, NULL, 0,
                                             NULL, logger, NULL);
    check(made != NULL, __LINE__);
    return made;
}

static void *model_exchange(void)
{
    void *made = fmi3InstantiateModelExchange("instance", model_token, "/nowhere/", false, true, NULL, logger);
    check(made != NULL, __LINE__);
    return made;
}

static void initialize(void *instance)
{
    check(fmi3EnterInitializationMode(instance, false, 0.0, 0.0, true, 2.0) == STATUS_OK, __LINE__);
    check(fmi3ExitInitializationMode(instance) == STATUS_OK, __LINE__);
}

static double real(void *instance, uint32_t reference)
{
    double value = NAN;
    check(fmi3GetFloat64(instance, &reference, 1, &value, 1) == STATUS_OK, __LINE__);
    return value;
}

static Status set_real(void *instance, uint32_t reference, double value)
{
    return fmi3SetFloat64(instance, &reference, 1, &value, 1);
}

static Status set_policy(void *instance, int32_t value)
{
    const uint32_t reference = DOMAIN_POLICY;
    return fmi3SetInt32(instance, &reference, 1, &value, 1);
}

static Status step(void *instance, double from, double size)
{
    bool event = true;
    bool terminate = true;
    bool early = true;
    double reached = NAN;
    const Status status = fmi3DoStep(instance, from, size, true, &event, &terminate, &early, &reached);
    check(status == STATUS_ERROR || (!event && !terminate && !early), __LINE__);
    check(status != STATUS_OK || reached == from + size, __LINE__);
    return status;
}

static void instantiation(void)
{
    check(fmi3InstantiateCoSimulation(NULL, model_token, NULL, false, false, false, false, NULL, 0, NULL, NULL,
                                      NULL) == NULL, __LINE__);
    check(fmi3InstantiateModelExchange("x", "{wrong}", NULL, false, false, NULL, logger) == NULL, __LINE__);
    check(messages == 1 && strstr(last_message, "{wrong}") != NULL, __LINE__);
    check(fmi3InstantiateModelExchange("x", NULL, NULL, false, false, NULL, logger) == NULL, __LINE__);
    check(fmi3InstantiateScheduledExecution("x", model_token, NULL, false, false, NULL, logger, NULL, NULL, NULL) ==
              NULL, __LINE__);
    fmi3FreeInstance(NULL);
    check(strcmp(fmi3GetVersion(), "3.0") == 0, __LINE__);
}

static void co_simulation_run(void)
{
    void *instance = co_simulation(false);
    const uint32_t references[] = {LENGTH, ANGLE};
    double read[2];
    const uint32_t calculated[] = {ANGLE, TIME, DISTANCE};
    for (size_t i = 0; i < 3; i++) {
        refused(fmi3GetFloat64(instance, &calculated[i], 1, read, 1), __LINE__);
        check(strstr(last_message, "has no start value") != NULL && fmi3Reset(instance) == STATUS_OK, __LINE__);
    }
    check(real(instance, LENGTH) == 0.5 * (0.1 + 0.2), __LINE__); /* FMI 3.0 lets start values be read */
    check(set_real(instance, LENGTH, 0.12) == STATUS_OK, __LINE__);
    initialize(instance);
    const double start = real(instance, ANGLE);
    check(step(instance, 0.0, 0.5) == STATUS_OK && real(instance, TIME) == 0.5, __LINE__);
    messages = 0;
    check(real(instance, ANGLE) != start && set_real(instance, SPEED, 3.0) == STATUS_OK, __LINE__);
    check(messages == 1 && strstr(last_message, "changed from 2.5 to 3 during the run") != NULL, __LINE__);
    check(fmi3GetFloat64(instance, references, 2, read, 2) == STATUS_OK && read[0] == 0.12, __LINE__);
    check(fmi3Terminate(instance) == STATUS_OK && real(instance, ANGLE) == read[1], __LINE__);
    check(fmi3Reset(instance) == STATUS_OK, __LINE__);
    initialize(instance);
    messages = 0;
    refused(fmi3EnterEventMode(instance), __LINE__);
    check(step(instance, 0.0, 0.1) == STATUS_OK, __LINE__); /* the refusal changed nothing */
    fmi3Reset(instance);
    initialize(instance);
    refused(fmi3DoStep(instance, 0.0, 0.1, true, NULL, NULL, NULL, NULL), __LINE__);
    fmi3Reset(instance);
    initialize(instance);
    refused(step(instance, 0.0, NAN), __LINE__);
    fmi3Reset(instance);
    initialize(instance);
    refused(fmi3GetFloat64(instance, references, 2, read, 1), __LINE__);
    refused(fmi3GetFloat64(instance, (const uint32_t[]){UNKNOWN}, 1, read, 1), __LINE__);
    check(fmi3GetFloat64(instance, (const uint32_t[]){DOMAIN_POLICY}, 1, read, 1) == STATUS_OK && read[0] == 0.0, __LINE__);
    refused(fmi3GetFloat64(instance, NULL, 1, read, 1), __LINE__);
    refused(fmi3GetFloat32(instance, references, 1, NULL, 1), __LINE__);
    check(fmi3GetString(instance, NULL, 0, NULL, 0) == STATUS_OK, __LINE__);
    fmi3FreeInstance(instance);
}

static void event_mode(void)
{
    void *instance = co_simulation(true);
    bool flags[5] = {true, true, true, true, true};
    double next = -1.0;
    initialize(instance);
    check(fmi3UpdateDiscreteStates(instance, &flags[0], &flags[1], &flags[2], &flags[3], &flags[4], &next) ==
              STATUS_OK && !flags[0] && !flags[4], __LINE__);
    check(fmi3EvaluateDiscreteStates(instance) == STATUS_OK && fmi3EnterStepMode(instance) == STATUS_OK, __LINE__);
    check(step(instance, 0.0, 0.25) == STATUS_OK && fmi3EnterEventMode(instance) == STATUS_OK, __LINE__);
    check(set_real(instance, SPEED, 2.5) == STATUS_OK && fmi3EnterStepMode(instance) == STATUS_OK, __LINE__);
    check(step(instance, 0.25, 0.25) == STATUS_OK, __LINE__);
    fmi3FreeInstance(instance);
}

static void model_exchange_run(void)
{
    void *instance = model_exchange();
    bool enter = true;
    bool terminate = true;
    size_t count = 7;
    initialize(instance);
    check(fmi3EnterContinuousTimeMode(instance) == STATUS_OK && fmi3SetTime(instance, 0.75) == STATUS_OK, __LINE__);
    check(real(instance, TIME) == 0.75 && set_real(instance, SPEED, 9.0) == STATUS_OK, __LINE__);
    check(fmi3SetTime(instance, 3.81) == STATUS_OK && fmi3SetTime(instance, 0.75) == STATUS_OK, __LINE__);
    check(set_real(instance, SPEED, 2.5) == STATUS_OK, __LINE__);
    check(fmi3CompletedIntegratorStep(instance, true, &enter, &terminate) == STATUS_OK && !enter, __LINE__);
    messages = 0;
    check(set_real(instance, SPEED, 9.0) == STATUS_OK, __LINE__);
    check(fmi3CompletedIntegratorStep(instance, true, &enter, &terminate) == STATUS_OK && messages == 2, __LINE__);
    check(fmi3GetNumberOfContinuousStates(instance, &count) == STATUS_OK && count == 0, __LINE__);
    check(fmi3GetContinuousStateDerivatives(instance, NULL, 0) == STATUS_OK, __LINE__);
    check(fmi3SetTime(instance, 0.5) == STATUS_OK && fmi3EnterEventMode(instance) == STATUS_OK, __LINE__);
    check(fmi3EnterContinuousTimeMode(instance) == STATUS_OK, __LINE__);
    messages = 0;
    check(fmi3SetTime(instance, 0.25) == STATUS_OK && real(instance, TIME) == 0.25, __LINE__); /* back across an event */
    fmi3Reset(instance);
    initialize(instance);
    refused(step(instance, 0.0, 0.1), __LINE__);
    fmi3FreeInstance(instance);
}

static void domain(void)
{
    void *instance = co_simulation(false);
    const uint32_t reference = IN_DOMAIN;
    bool inside = false;
    initialize(instance);
    check(fmi3GetBoolean(instance, &reference, 1, &inside, 1) == STATUS_OK && inside, __LINE__);
    check(set_real(instance, SPEED, 10.0) == STATUS_OK && real(instance, DISTANCE) == 1.0, __LINE__);
    check(fmi3GetBoolean(instance, &reference, 1, &inside, 1) == STATUS_OK && !inside, __LINE__);
    fmi3Reset(instance);
    check(set_policy(instance, 2) == STATUS_OK, __LINE__);
    check(fmi3EnterInitializationMode(instance, false, 0.0, 0.0, false, 0.0) == STATUS_OK, __LINE__);
    check(fmi3ExitInitializationMode(instance) == STATUS_OK && step(instance, 0.0, 2.5) == STATUS_DISCARD, __LINE__);
    check(step(instance, 0.0, 1.5) == STATUS_OK, __LINE__); /* tried again with a smaller step */
    messages = 0;
    refused(fmi3SetBoolean(instance, &reference, 1, &inside, 1), __LINE__);
    fmi3FreeInstance(instance);
}

/* Errors are logged whatever was asked for, warnings when they are. */
static void logging(void)
{
    void *instance = fmi3InstantiateModelExchange("instance", model_token, NULL, false, false, NULL, logger);
    messages = 0;
    check(set_real(instance, SPEED, 9.0) == STATUS_OK && messages == 0, __LINE__);
    refused(fmi3SetTime(instance, 0.0), __LINE__);
    check(fmi3SetDebugLogging(instance, true, 0, NULL) == STATUS_OK && fmi3Reset(instance) == STATUS_OK, __LINE__);
    check(set_real(instance, SPEED, 9.0) == STATUS_OK && messages == 1, __LINE__);
    check(fmi3SetDebugLogging(instance, false, 0, NULL) == STATUS_OK, __LINE__);
    refused(fmi3SetTime(instance, 0.0), __LINE__);
    fmi3FreeInstance(instance);
}

static void derivatives(void)
{
    void *instance = co_simulation(false);
    const uint32_t unknowns[] = {ANGLE, VELOCITY};
    const uint32_t knowns[] = {LENGTH, SPEED, TIME};
    const double direction[] = {0.5, -1.0, 2.0};
    const double weights[] = {3.0, -0.25};
    double along[2];
    double gradient[3];
    double rate[1];
    size_t dependencies = 0;
    initialize(instance);
    check(fmi3GetDirectionalDerivative(instance, unknowns, 2, knowns, 3, direction, 3, along, 2) == STATUS_OK,
          __LINE__);
    check(fmi3GetAdjointDerivative(instance, unknowns, 2, knowns, 3, weights, 2, gradient, 3) == STATUS_OK, __LINE__);
    /* weights (J direction) = (J^T weights) direction */
    const double left = weights[0] * along[0] + weights[1] * along[1];
    const double right = gradient[0] * direction[0] + gradient[1] * direction[1] + gradient[2] * direction[2];
    check(fabs(left - right) < 1e-12 * (fabs(gradient[0]) + fabs(gradient[1]) + fabs(gradient[2])), __LINE__);
    check(fmi3GetOutputDerivatives(instance, unknowns, 1, (const int32_t[]){1}, rate, 1) == STATUS_OK, __LINE__);
    check(fmi3GetDirectionalDerivative(instance, unknowns, 1, &knowns[2], 1, (const double[]){1.0}, 1, along, 1) ==
              STATUS_OK && fabs(along[0] - rate[0]) < 1e-13, __LINE__);
    check(fmi3GetNumberOfVariableDependencies(instance, ANGLE, &dependencies) == STATUS_OK && dependencies == 4,
          __LINE__);
    messages = 0;
    refused(fmi3GetAdjointDerivative(instance, unknowns, 2, knowns, 3, weights, 1, gradient, 3), __LINE__);
    refused(fmi3GetAdjointDerivative(instance, NULL, 2, knowns, 3, weights, 2, gradient, 3), __LINE__);
    refused(fmi3GetNumberOfVariableDependencies(instance, UNKNOWN, &dependencies), __LINE__);
    fmi3FreeInstance(instance);
}

static void states(void)
{
    void *instance = co_simulation(false);
    void *state = NULL;
    void *copy = NULL;
    size_t size = 0;
    uint8_t bytes[4096];
    initialize(instance);
    check(step(instance, 0.0, 0.5) == STATUS_OK, __LINE__);
    const double expected = real(instance, ANGLE);
    check(fmi3GetFMUState(instance, &state) == STATUS_OK, __LINE__);
    check(fmi3SerializedFMUStateSize(instance, state, &size) == STATUS_OK && size < sizeof bytes, __LINE__);
    check(fmi3SerializeFMUState(instance, state, bytes, size) == STATUS_OK, __LINE__);
    check(step(instance, 0.5, 0.5) == STATUS_OK && fmi3SetFMUState(instance, state) == STATUS_OK, __LINE__);
    check(real(instance, ANGLE) == expected, __LINE__);
    fmi3Reset(instance);
    check(fmi3DeserializeFMUState(instance, bytes, size, &copy) == STATUS_OK, __LINE__);
    check(fmi3SetFMUState(instance, copy) == STATUS_OK && real(instance, ANGLE) == expected, __LINE__);
    bytes[20] ^= 1;
    messages = 0;
    refused(fmi3DeserializeFMUState(instance, bytes, size, &copy), __LINE__);
    check(fmi3FreeFMUState(instance, &state) == STATUS_OK && fmi3FreeFMUState(instance, &copy) == STATUS_OK, __LINE__);
    check(state == NULL && fmi3FreeFMUState(instance, NULL) == STATUS_OK, __LINE__);
    fmi3FreeInstance(instance);
}

static void absent(void)
{
    void *instance = co_simulation(true);
    const uint32_t reference = LENGTH;
    bool clock;
    initialize(instance);
    check(fmi3GetClock(instance, NULL, 0, NULL) == STATUS_OK, __LINE__);
    messages = 0;
    refused(fmi3GetClock(instance, &reference, 1, &clock), __LINE__);
    check(fmi3EnterConfigurationMode(instance) == STATUS_OK, __LINE__);
    check(fmi3ExitConfigurationMode(instance) == STATUS_OK, __LINE__);
    refused(fmi3ActivateModelPartition(instance, 0, 0.0), __LINE__);
    check(fmi3DoStep(NULL, 0.0, 0.1, true, NULL, NULL, NULL, NULL) == STATUS_ERROR, __LINE__);
    check(fmi3GetFloat64(NULL, NULL, 0, NULL, 0) == STATUS_ERROR, __LINE__);
    check(fmi3GetBinary(NULL, NULL, 0, NULL, NULL, 0) == STATUS_ERROR, __LINE__);
    fmi3FreeInstance(instance);
}

int main(void)
{
    instantiation();
    co_simulation_run();
    event_mode();
    model_exchange_run();
    domain();
    logging();
    derivatives();
    states();
    absent();
    return 0;
}

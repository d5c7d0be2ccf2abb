/*
 * Calls every function of FMI 2.0, as a host that knows the standard and as one that does not. The FMU has the columns
 * `length` (tunable, 0.1 to 0.2), `speed` (an input, 0 to 5), `time` (0 to 2) and two outputs.
 */
#include "fmi2.h"
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LENGTH = 1, SPEED, TIME, ANGLE, VELOCITY, DOMAIN_POLICY, IN_DOMAIN, DISTANCE, UNKNOWN };

static int messages = 0;
static fmi2Status last_severity = fmi2OK;
static char last_message[MESSAGE_SIZE];

static void logger(void *environment, const char *name, fmi2Status status, const char *category, const char *format, ...)
{
    va_list arguments;
    (void)environment;
    (void)name;
    (void)category;
    last_severity = status;
    va_start(arguments, format);
    vsnprintf(last_message, sizeof last_message, format, arguments);
    va_end(arguments);
    messages++;
}

static void check(bool good, int line)
{
    if (!good) {
        printf("line %d: not so; last message: %s\n", line, last_message);
        exit(1);
    }
}

/* A refusal comes with a message. */
static void refused(Status status, int line)
{
    check(status == STATUS_ERROR && messages > 0, line);
    messages = 0;
}

static const fmi2CallbackFunctions with_memory = {logger, calloc, free, NULL, NULL};
static const fmi2CallbackFunctions without_memory = {logger, NULL, NULL, NULL, NULL};

static void *made(int kind, const fmi2CallbackFunctions *functions)
{
    void *c = fmi2Instantiate("instance", kind, model_token, "file:///nowhere", functions, 0, 0);
    check(c != NULL, __LINE__);
    return c;
}

static void initialize(void *c)
{
    check(fmi2SetupExperiment(c, 0, 0.0, 0.0, 1, 2.0) == STATUS_OK, __LINE__);
    check(fmi2EnterInitializationMode(c) == STATUS_OK, __LINE__);
    check(fmi2ExitInitializationMode(c) == STATUS_OK, __LINE__);
}

static double real(void *c, uint32_t reference)
{
    double value = NAN;
    check(fmi2GetReal(c, &reference, 1, &value) == STATUS_OK, __LINE__);
    return value;
}

static Status set_real(void *c, uint32_t reference, double value)
{
    return fmi2SetReal(c, &reference, 1, &value);
}

static Status set_policy(void *c, int32_t value)
{
    const uint32_t reference = DOMAIN_POLICY;
    return fmi2SetInteger(c, &reference, 1, &value);
}

static bool in_domain(void *c)
{
    const uint32_t reference = IN_DOMAIN;
    int value = -1;
    check(fmi2GetBoolean(c, &reference, 1, &value) == STATUS_OK, __LINE__);
    return value == 1;
}

static void instantiation(void)
{
    check(fmi2Instantiate("x", 1, model_token, NULL, NULL, 0, 0) == NULL, __LINE__);
    check(fmi2Instantiate(NULL, 1, model_token, NULL, &with_memory, 0, 0) == NULL, __LINE__);
    check(fmi2Instantiate(" \t", 1, model_token, NULL, &with_memory, 0, 0) == NULL, __LINE__);
    check(strstr(last_message, "name is empty") != NULL, __LINE__);
    check(fmi2Instantiate("x", 1, NULL, NULL, &with_memory, 0, 0) == NULL, __LINE__);
    check(fmi2Instantiate("x", 1, "{wrong}", NULL, &with_memory, 0, 0) == NULL, __LINE__);
    check(strstr(last_message, "{wrong}") != NULL && strstr(last_message, model_token) != NULL, __LINE__);
    check(fmi2Instantiate("x", 7, model_token, NULL, &with_memory, 0, 0) == NULL, __LINE__);
    fmi2FreeInstance(made(0, &without_memory));
    fmi2FreeInstance(made(1, &with_memory));
    fmi2FreeInstance(NULL);
    check(strcmp(fmi2GetVersion(), "2.0") == 0 && strcmp(fmi2GetTypesPlatform(), "default") == 0, __LINE__);
}

/* After a refusal the instance is as it was. */
static void values(void)
{
    void *c = made(1, &with_memory);
    const uint32_t references[] = {LENGTH, ANGLE, UNKNOWN};
    double read[3];
    int integer;
    const double good = 0.16;
    refused(fmi2GetReal(c, &references[1], 1, read), __LINE__);
    check(fmi2GetReal(c, references, 1, read) == STATUS_OK && fmi2Reset(c) == STATUS_OK, __LINE__);
    check(set_real(c, LENGTH, 0.12) == STATUS_OK, __LINE__);
    initialize(c);
    check(real(c, LENGTH) == 0.12 && real(c, SPEED) == 2.5 && real(c, TIME) == 0.0, __LINE__);
    check(isfinite(real(c, ANGLE)) && real(c, DISTANCE) == 0.0 && in_domain(c), __LINE__);
    check(fmi2GetReal(c, NULL, 0, NULL) == STATUS_OK && fmi2GetString(c, NULL, 0, NULL) == STATUS_OK, __LINE__);
    for (int i = 0; i < 12; i++) {
        const uint32_t reference = i < 3 ? (uint32_t)(UNKNOWN + i * 1000000000) : (uint32_t)ANGLE;
        fmi2Reset(c);
        initialize(c);
        messages = 0;
        switch (i) {
        case 0:
        case 1:
        case 2:
            refused(fmi2GetReal(c, &reference, 1, read), __LINE__);
            check(strstr(last_message, "expected at most 8") != NULL, __LINE__);
            break;
        case 3:
            refused(fmi2GetReal(c, NULL, 3, read), __LINE__);
            break;
        case 4:
            refused(fmi2GetReal(c, references, 3, NULL), __LINE__);
            break;
        case 5:
            refused(set_real(c, ANGLE, 1.0), __LINE__);
            break;
        case 6:
            refused(set_real(c, TIME, 1.0), __LINE__);
            break;
        case 7:
            refused(set_real(c, LENGTH, NAN), __LINE__);
            break;
        case 8:
            refused(fmi2SetReal(c, references, 2, (const double[]){good, good}), __LINE__);
            check(real(c, LENGTH) != good, __LINE__); /* nothing was set */
            break;
        case 9:
            refused(fmi2GetInteger(c, references, 1, &integer), __LINE__);
            break;
        case 10:
            refused(fmi2GetString(c, references, 1, NULL), __LINE__);
            break;
        default:
            refused(set_policy(c, 3), __LINE__);
            break;
        }
        check(fmi2DoStep(c, 0.0, 0.1, 1) == STATUS_OK, __LINE__);
    }
    fmi2FreeInstance(c);
}

static void steps(void)
{
    void *c = made(1, &with_memory);
    const double bad[] = {NAN, INFINITY, -INFINITY, 1e308, -0.1};
    initialize(c);
    check(fmi2DoStep(c, 0.0, 0.1, 1) == STATUS_OK && real(c, TIME) == 0.1, __LINE__);
    check(fmi2DoStep(c, 0.1, 0.0, 1) == STATUS_OK, __LINE__);
    check(fmi2DoStep(c, 0.1 + 1e-12, 1.9, 1) == STATUS_OK, __LINE__);
    refused(fmi2DoStep(c, 2.0, 0.1, 1), __LINE__);
    for (size_t i = 0; i < 5; i++) {
        fmi2Reset(c);
        initialize(c);
        refused(fmi2DoStep(c, 0.0, bad[i], 1), __LINE__);
        fmi2Reset(c);
        initialize(c);
        refused(fmi2DoStep(c, bad[i], 0.1, 1), __LINE__);
    }
    fmi2FreeInstance(c);
}

static void domain(void)
{
    void *c = made(1, &with_memory);
    initialize(c);
    const double inside = real(c, ANGLE);
    messages = 0;
    check(set_real(c, SPEED, 10.0) == STATUS_OK && messages == 1 && last_severity == STATUS_WARNING, __LINE__);
    check(set_real(c, SPEED, 10.0) == STATUS_OK && messages == 1, __LINE__);
    check(!in_domain(c) && real(c, DISTANCE) == 1.0 && real(c, ANGLE) != inside, __LINE__);
    const double outside = real(c, ANGLE);
    check(set_policy(c, 1) == STATUS_OK && real(c, ANGLE) != outside, __LINE__);
    const double clamped = real(c, ANGLE);
    check(real(c, SPEED) == 10.0 && !in_domain(c), __LINE__);
    check(set_real(c, SPEED, 5.0) == STATUS_OK && real(c, ANGLE) == clamped, __LINE__);
    check(set_policy(c, 2) == STATUS_OK, __LINE__);
    refused(set_real(c, SPEED, 6.0), __LINE__);
    check(strstr(last_message, "`speed`: 6 is outside the training range from 0 to 5") != NULL, __LINE__);
    fmi2Reset(c);
    check(set_real(c, SPEED, 10.0) == STATUS_OK, __LINE__);
    refused(set_policy(c, 2), __LINE__);
    fmi2FreeInstance(c);
}

static void states(void)
{
    void *c = made(1, &with_memory);
    void *other = made(0, &with_memory);
    void *state = NULL;
    void *copy = NULL;
    size_t size = 0;
    char bytes[4096];
    initialize(c);
    check(set_real(c, SPEED, 3.25) == STATUS_OK && fmi2DoStep(c, 0.0, 0.5, 1) == STATUS_OK, __LINE__);
    const double expected = real(c, ANGLE);
    check(fmi2GetFMUstate(c, &state) == STATUS_OK && fmi2GetFMUstate(c, &state) == STATUS_OK, __LINE__);
    check(fmi2SerializedFMUstateSize(c, state, &size) == STATUS_OK && size < sizeof bytes, __LINE__);
    check(fmi2SerializeFMUstate(c, state, bytes, size) == STATUS_OK, __LINE__);
    check(fmi2DoStep(c, 0.5, 0.5, 1) == STATUS_OK && real(c, ANGLE) != expected, __LINE__);
    check(fmi2SetFMUstate(c, state) == STATUS_OK && real(c, ANGLE) == expected, __LINE__);
    fmi2Reset(c);
    check(fmi2DeSerializeFMUstate(c, bytes, size, &copy) == STATUS_OK, __LINE__);
    check(fmi2SetFMUstate(c, copy) == STATUS_OK && real(c, ANGLE) == expected, __LINE__);
    check(fmi2DoStep(c, 0.5, 0.5, 1) == STATUS_OK, __LINE__);
    refused(fmi2SetFMUstate(other, state), __LINE__); /* another interface */
    for (size_t i = 0; i < size; i++) {
        bytes[i] = (char)(bytes[i] ^ 0x10);
        refused(fmi2DeSerializeFMUstate(c, bytes, size, &copy), __LINE__);
        bytes[i] = (char)(bytes[i] ^ 0x10);
        refused(fmi2DeSerializeFMUstate(c, bytes, i, &copy), __LINE__);
    }
    refused(fmi2DeSerializeFMUstate(c, NULL, 0, &copy), __LINE__);
    refused(fmi2DeSerializeFMUstate(c, NULL, size, &copy), __LINE__);
    refused(fmi2DeSerializeFMUstate(c, bytes, size, NULL), __LINE__);
    refused(fmi2SerializeFMUstate(c, state, NULL, size), __LINE__);
    refused(fmi2SerializeFMUstate(c, state, bytes, size - 1), __LINE__);
    refused(fmi2SetFMUstate(c, NULL), __LINE__);
    refused(fmi2GetFMUstate(c, NULL), __LINE__);
    check(fmi2FreeFMUstate(c, NULL) == STATUS_OK && fmi2FreeFMUstate(c, &state) == STATUS_OK, __LINE__);
    check(state == NULL && fmi2FreeFMUstate(c, &state) == STATUS_OK, __LINE__);
    check(fmi2FreeFMUstate(c, &copy) == STATUS_OK, __LINE__);
    fmi2FreeInstance(c);
    fmi2FreeInstance(other);
}

static void derivatives(void)
{
    void *c = made(1, &with_memory);
    const uint32_t unknowns[] = {ANGLE, VELOCITY, DISTANCE};
    const uint32_t speed = SPEED;
    const uint32_t angle = ANGLE;
    const double one = 1.0;
    const double step = 1e-5;
    const int32_t orders[] = {1, 2};
    double columns[3];
    double along[2];
    initialize(c);
    check(fmi2GetDirectionalDerivative(c, unknowns, 3, &speed, 1, &one, columns) == STATUS_OK, __LINE__);
    check(set_real(c, SPEED, 2.5 + step) == STATUS_OK, __LINE__);
    const double later = real(c, ANGLE);
    check(set_real(c, SPEED, 2.5 - step) == STATUS_OK, __LINE__);
    const double quotient = (later - real(c, ANGLE)) / (2.0 * step);
    check(fabs(columns[0] - quotient) < 1e-8 * fabs(quotient) && columns[2] == 0.0, __LINE__);

    /* an input that follows its derivative, and the outputs' derivatives along it */
    fmi2Reset(c);
    initialize(c);
    check(fmi2SetRealInputDerivatives(c, &speed, 1, orders, (const double[]){2.0}) == STATUS_OK, __LINE__);
    messages = 0;
    check(fmi2DoStep(c, 0.0, 0.5 - step, 1) == STATUS_OK && messages == 1, __LINE__); /* it changes */
    const double before = real(c, ANGLE);
    check(fmi2DoStep(c, 0.5 - step, step, 1) == STATUS_OK && fabs(real(c, SPEED) - 3.5) < 1e-12, __LINE__);
    const double now = real(c, ANGLE);
    check(fmi2GetRealOutputDerivatives(c, (const uint32_t[]){ANGLE, ANGLE}, 2, orders, along) == STATUS_OK, __LINE__);
    check(fmi2DoStep(c, 0.5, step, 1) == STATUS_OK, __LINE__);
    const double after = real(c, ANGLE);
    check(fabs(along[0] - (after - before) / (2.0 * step)) < 1e-6, __LINE__);
    check(fabs(along[1] - (after - 2.0 * now + before) / (step * step)) < 1e-3, __LINE__);

    refused(fmi2GetDirectionalDerivative(c, &speed, 1, &speed, 1, &one, columns), __LINE__);
    refused(fmi2GetDirectionalDerivative(c, &angle, 1, &angle, 1, &one, columns), __LINE__);
    refused(fmi2GetDirectionalDerivative(c, &angle, 1, &speed, 1, NULL, columns), __LINE__);
    refused(fmi2GetRealOutputDerivatives(c, &angle, 1, (const int32_t[]){3}, columns), __LINE__);
    check(fmi2SetRealInputDerivatives(c, &speed, 1, orders, &one) == STATUS_OK, __LINE__); /* after an error */
    fmi2FreeInstance(c);
}

static void model_exchange(void)
{
    void *c = made(0, &with_memory);
    fmi2EventInfo info;
    int enter = 1;
    int terminate = 1;
    initialize(c);
    check(fmi2NewDiscreteStates(c, &info) == STATUS_OK && info.newDiscreteStatesNeeded == 0, __LINE__);
    check(fmi2EnterContinuousTimeMode(c) == STATUS_OK && fmi2SetTime(c, 0.25) == STATUS_OK, __LINE__);
    check(real(c, TIME) == 0.25 && set_real(c, SPEED, 2.5) == STATUS_OK, __LINE__);
    check(fmi2CompletedIntegratorStep(c, 1, &enter, &terminate) == STATUS_OK && !enter && !terminate, __LINE__);
    check(fmi2GetDerivatives(c, NULL, 0) == STATUS_OK && fmi2GetEventIndicators(c, NULL, 0) == STATUS_OK, __LINE__);
    check(fmi2GetContinuousStates(c, NULL, 0) == STATUS_OK, __LINE__);
    check(fmi2GetNominalsOfContinuousStates(c, NULL, 0) == STATUS_OK, __LINE__);
    check(fmi2SetContinuousStates(c, NULL, 0) == STATUS_OK && fmi2EnterEventMode(c) == STATUS_OK, __LINE__);
    check(fmi2EnterContinuousTimeMode(c) == STATUS_OK, __LINE__);
    check(set_real(c, LENGTH, 0.12) == STATUS_OK && real(c, LENGTH) == 0.12, __LINE__); /* tunable: a solver may try values */
    fmi2Reset(c);
    initialize(c);
    refused(fmi2DoStep(c, 0.0, 0.1, 1), __LINE__);
    check(strstr(last_message, "only in a state this FMU never enters") != NULL, __LINE__);
    fmi2Reset(c);
    initialize(c);
    refused(fmi2SetTime(c, NAN), __LINE__);
    fmi2FreeInstance(c);
}

/* A solver tries what it likes; what it accepts outside the domain is logged, or refused if that is the policy. */
static void trials(void)
{
    for (int32_t policy = 0; policy < 3; policy++) {
        void *c = made(0, &with_memory);
        int enter = 1;
        int terminate = 1;
        check(set_policy(c, policy) == STATUS_OK, __LINE__);
        initialize(c);
        messages = 0;
        check(fmi2EnterContinuousTimeMode(c) == STATUS_OK && fmi2SetTime(c, 3.81) == STATUS_OK, __LINE__);
        check(set_real(c, SPEED, 9.0) == STATUS_OK && !in_domain(c) && messages == 0, __LINE__);
        check(set_real(c, SPEED, 2.5) == STATUS_OK && fmi2SetTime(c, 0.5) == STATUS_OK && in_domain(c), __LINE__);
        check(fmi2CompletedIntegratorStep(c, 1, &enter, &terminate) == STATUS_OK && messages == 0, __LINE__);
        check(fmi2SetTime(c, 2.5) == STATUS_OK, __LINE__);
        const Status status = fmi2CompletedIntegratorStep(c, 1, &enter, &terminate);
        check(status == (policy == 2 ? STATUS_ERROR : STATUS_OK), __LINE__);
        check(messages == (policy == 1 ? 0 : 1), __LINE__);
        fmi2Reset(c);
        initialize(c);
        messages = 0;
        check(fmi2EnterContinuousTimeMode(c) == STATUS_OK && fmi2SetTime(c, 2.5) == STATUS_OK, __LINE__);
        check(fmi2EnterEventMode(c) == STATUS_OK && messages == 1, __LINE__);
        fmi2FreeInstance(c);
    }
}

/* A host that never completes a step accepts what it leaves behind. */
static void never_completed(void)
{
    void *c = made(0, &with_memory);
    check(set_policy(c, 2) == STATUS_OK, __LINE__);
    initialize(c);
    check(fmi2EnterContinuousTimeMode(c) == STATUS_OK && set_real(c, SPEED, 9.0) == STATUS_OK, __LINE__);
    for (int repeated = 0; repeated < 3; repeated++) {
        for (int step = 1; step <= 1000; step++) {
            check(fmi2SetTime(c, step * 1e-3) == STATUS_OK, __LINE__);
        }
    }
    refused(fmi2SetTime(c, 1.001), __LINE__);
    fmi2FreeInstance(c);
}

/* Inputs and parameters that do not stay what they were at the start of the run. */
static void changes(void)
{
    const uint32_t references[] = {LENGTH, SPEED};
    const double rate = 0.5;
    const int32_t order = 1;
    const uint32_t speed = SPEED;
    int enter = 1;
    int terminate = 1;
    for (int i = 0; i < 2; i++) {
        void *c = made(1, &with_memory);
        void *state = NULL;
        initialize(c);
        check(set_real(c, references[i], 0.19) == STATUS_OK && fmi2DoStep(c, 0.0, 0.5, 1) == STATUS_OK, __LINE__);
        messages = 0;
        check(set_real(c, references[i], 0.19) == STATUS_OK && in_domain(c) && messages == 0, __LINE__);
        check(set_real(c, references[i], 0.12) == STATUS_OK && !in_domain(c) && messages == 1, __LINE__);
        check(strstr(last_message, "changed from 0.19 to 0.12 during the run") != NULL, __LINE__);
        check(set_real(c, references[i], 0.19) == STATUS_OK && !in_domain(c) && messages == 1, __LINE__);
        check(fmi2GetFMUstate(c, &state) == STATUS_OK && fmi2Reset(c) == STATUS_OK, __LINE__);
        initialize(c);
        check(in_domain(c) && fmi2SetFMUstate(c, state) == STATUS_OK && !in_domain(c), __LINE__);
        refused(set_policy(c, 2), __LINE__);
        fmi2Reset(c);
        initialize(c);
        check(set_policy(c, 2) == STATUS_OK && fmi2DoStep(c, 0.0, 0.5, 1) == STATUS_OK, __LINE__);
        refused(set_real(c, references[i], 0.12), __LINE__);
        fmi2Reset(c);
        initialize(c);
        check(fmi2SetRealInputDerivatives(c, &speed, 1, &order, &rate) == STATUS_OK, __LINE__);
        check(fmi2DoStep(c, 0.0, 0.5, 1) == STATUS_OK && !in_domain(c), __LINE__);
        check(fmi2FreeFMUstate(c, &state) == STATUS_OK, __LINE__);
        fmi2FreeInstance(c);
    }
    void *c = made(0, &with_memory);
    initialize(c);
    check(fmi2EnterContinuousTimeMode(c) == STATUS_OK && set_real(c, SPEED, 1.0) == STATUS_OK, __LINE__);
    check(fmi2SetTime(c, 0.5) == STATUS_OK && in_domain(c), __LINE__);
    check(set_real(c, SPEED, 2.0) == STATUS_OK && !in_domain(c), __LINE__);
    check(set_real(c, SPEED, 1.0) == STATUS_OK && in_domain(c), __LINE__);
    check(fmi2CompletedIntegratorStep(c, 1, &enter, &terminate) == STATUS_OK, __LINE__);
    check(set_real(c, SPEED, 2.0) == STATUS_OK, __LINE__);
    messages = 0;
    check(fmi2CompletedIntegratorStep(c, 1, &enter, &terminate) == STATUS_OK && messages == 1, __LINE__);
    fmi2FreeInstance(c);
}

static void null_components(void)
{
    void *state = NULL;
    size_t size;
    double value;
    int integer;
    fmi2EventInfo info;
    Status status;
    const char *text;
    check(fmi2SetDebugLogging(NULL, 1, 0, NULL) == STATUS_ERROR, __LINE__);
    check(fmi2SetupExperiment(NULL, 0, 0.0, 0.0, 0, 0.0) == STATUS_ERROR, __LINE__);
    check(fmi2EnterInitializationMode(NULL) == STATUS_ERROR && fmi2Terminate(NULL) == STATUS_ERROR, __LINE__);
    check(fmi2ExitInitializationMode(NULL) == STATUS_ERROR && fmi2Reset(NULL) == STATUS_ERROR, __LINE__);
    check(fmi2GetReal(NULL, NULL, 0, NULL) == STATUS_ERROR && set_real(NULL, LENGTH, 0.0) == STATUS_ERROR, __LINE__);
    check(fmi2GetInteger(NULL, NULL, 0, NULL) == STATUS_ERROR && set_policy(NULL, 0) == STATUS_ERROR, __LINE__);
    check(fmi2GetBoolean(NULL, NULL, 0, NULL) == STATUS_ERROR, __LINE__);
    check(fmi2SetBoolean(NULL, NULL, 0, NULL) == STATUS_ERROR, __LINE__);
    check(fmi2GetString(NULL, NULL, 0, NULL) == STATUS_ERROR, __LINE__);
    check(fmi2SetString(NULL, NULL, 0, NULL) == STATUS_ERROR, __LINE__);
    check(fmi2GetFMUstate(NULL, &state) == STATUS_ERROR && fmi2SetFMUstate(NULL, state) == STATUS_ERROR, __LINE__);
    check(fmi2FreeFMUstate(NULL, &state) == STATUS_ERROR, __LINE__);
    check(fmi2SerializedFMUstateSize(NULL, state, &size) == STATUS_ERROR, __LINE__);
    check(fmi2SerializeFMUstate(NULL, state, NULL, 0) == STATUS_ERROR, __LINE__);
    check(fmi2DeSerializeFMUstate(NULL, NULL, 0, &state) == STATUS_ERROR, __LINE__);
    check(fmi2GetDirectionalDerivative(NULL, NULL, 0, NULL, 0, NULL, NULL) == STATUS_ERROR, __LINE__);
    check(fmi2SetRealInputDerivatives(NULL, NULL, 0, NULL, NULL) == STATUS_ERROR, __LINE__);
    check(fmi2GetRealOutputDerivatives(NULL, NULL, 0, NULL, NULL) == STATUS_ERROR, __LINE__);
    check(fmi2EnterEventMode(NULL) == STATUS_ERROR && fmi2NewDiscreteStates(NULL, &info) == STATUS_ERROR, __LINE__);
    check(fmi2EnterContinuousTimeMode(NULL) == STATUS_ERROR && fmi2SetTime(NULL, 0.0) == STATUS_ERROR, __LINE__);
    check(fmi2CompletedIntegratorStep(NULL, 0, &integer, &integer) == STATUS_ERROR, __LINE__);
    check(fmi2SetContinuousStates(NULL, NULL, 0) == STATUS_ERROR, __LINE__);
    check(fmi2GetContinuousStates(NULL, NULL, 0) == STATUS_ERROR, __LINE__);
    check(fmi2GetDerivatives(NULL, NULL, 0) == STATUS_ERROR, __LINE__);
    check(fmi2GetEventIndicators(NULL, NULL, 0) == STATUS_ERROR, __LINE__);
    check(fmi2GetNominalsOfContinuousStates(NULL, NULL, 0) == STATUS_ERROR, __LINE__);
    check(fmi2DoStep(NULL, 0.0, 0.1, 1) == STATUS_ERROR && fmi2CancelStep(NULL) == STATUS_ERROR, __LINE__);
    check(fmi2GetStatus(NULL, 0, &status) == STATUS_ERROR, __LINE__);
    check(fmi2GetRealStatus(NULL, 2, &value) == STATUS_ERROR, __LINE__);
    check(fmi2GetIntegerStatus(NULL, 0, &integer) == STATUS_ERROR, __LINE__);
    check(fmi2GetBooleanStatus(NULL, 3, &integer) == STATUS_ERROR, __LINE__);
    check(fmi2GetStringStatus(NULL, 1, &text) == STATUS_ERROR, __LINE__);
}

static void status_and_logging(void)
{
    void *c = made(1, &with_memory);
    double time = -1.0;
    int terminated = 1;
    const char *const known[] = {"logStatusError"};
    const char *const unknown[] = {"log #1"};
    const char *const missing[] = {NULL};
    initialize(c);
    check(fmi2DoStep(c, 0.0, 0.5, 1) == STATUS_OK, __LINE__);
    check(fmi2GetRealStatus(c, 2, &time) == STATUS_OK && time == 0.5, __LINE__);
    check(fmi2GetBooleanStatus(c, 3, &terminated) == STATUS_OK && terminated == 0, __LINE__);
    check(fmi2GetRealStatus(c, 1, &time) == STATUS_DISCARD && fmi2DoStep(c, 0.5, 0.1, 1) == STATUS_OK, __LINE__);
    check(fmi2SetDebugLogging(c, 1, 1, unknown) == STATUS_OK, __LINE__);
    check(strstr(last_message, "`log ##1` is unknown") != NULL, __LINE__);
    check(fmi2SetDebugLogging(c, 0, 1, known) == STATUS_OK, __LINE__);
    messages = 0;
    check(fmi2SetDebugLogging(c, 0, 0, NULL) == STATUS_OK, __LINE__);
    refused(fmi2SetDebugLogging(c, 1, 1, missing), __LINE__); /* errors are logged whatever is switched off */
    refused(fmi2CancelStep(c), __LINE__);
    fmi2FreeInstance(c);
}

static void several_instances(void)
{
    void *instances[100];
    for (int i = 0; i < 100; i++) {
        instances[i] = made(1, i % 2 == 0 ? &with_memory : &without_memory);
        check(set_real(instances[i], LENGTH, 0.1 + 0.001 * i) == STATUS_OK, __LINE__);
        initialize(instances[i]);
    }
    for (int i = 0; i < 100; i++) {
        check(real(instances[i], LENGTH) == 0.1 + 0.001 * i, __LINE__);
        fmi2FreeInstance(instances[i]);
    }
}

int main(void)
{
    instantiation();
    values();
    steps();
    domain();
    states();
    derivatives();
    model_exchange();
    never_completed();
    trials();
    changes();
    null_components();
    status_and_logging();
    several_instances();
    return 0;
}

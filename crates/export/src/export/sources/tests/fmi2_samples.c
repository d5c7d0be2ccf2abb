/*
 * FMI 2.0 with samples: a mass that is pushed. Its inputs are the mass (fixed, 1 to 2), what position and force were
 * before the start, and a force (-3 to 3); the output is the position. The sample time is 0.1 s.
 */
#include "fmi2.h"
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MASS = 1, POSITION_START, FORCE_START, FORCE, POSITION, DOMAIN_POLICY };

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

static Status set(void *c, uint32_t reference, double value)
{
    return fmi2SetReal(c, &reference, 1, &value);
}

static double get(void *c, uint32_t reference)
{
    double value = 0.0;
    check(fmi2GetReal(c, &reference, 1, &value) == STATUS_OK, __LINE__);
    return value;
}

static bool same(double a, double b)
{
    return memcmp(&a, &b, sizeof a) == 0;
}

static void *stepping(int32_t policy)
{
    const uint32_t reference = DOMAIN_POLICY;
    void *c = fmi2Instantiate("mass", 1, model_token, NULL, &callbacks, 0, 0);
    check(c != NULL && set(c, POSITION_START, 0.4) == STATUS_OK && set(c, FORCE_START, 0.25) == STATUS_OK, __LINE__);
    check(fmi2SetInteger(c, &reference, 1, &policy) == STATUS_OK, __LINE__);
    check(fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0) == STATUS_OK, __LINE__);
    check(fmi2EnterInitializationMode(c) == STATUS_OK && same(get(c, POSITION), 0.4), __LINE__);
    check(set(c, POSITION_START, 0.5) == STATUS_OK && same(get(c, POSITION), 0.5), __LINE__);
    check(fmi2ExitInitializationMode(c) == STATUS_OK, __LINE__);
    messages = 0;
    return c;
}

static void only_co_simulation(void)
{
    check(fmi2Instantiate("mass", 0, model_token, NULL, &callbacks, 0, 0) == NULL, __LINE__);
    said("fmi2Instantiate: this FMU is discrete-time: it is for co-simulation, not for model exchange",
         __LINE__);
}

static void starts_belong_to_the_start(void)
{
    void *c = stepping(0);
    check(fmi2DoStep(c, 0.0, 0.1, 1) == STATUS_OK, __LINE__);
    check(set(c, POSITION_START, 0.1) == STATUS_ERROR, __LINE__);
    said("parameter `position_start` (value reference 2) is fixed and cannot be set", __LINE__);
    check(fmi2Reset(c) == STATUS_OK && fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0) == STATUS_OK, __LINE__);
    check(fmi2EnterInitializationMode(c) == STATUS_OK && same(get(c, POSITION), 0.5), __LINE__);
    fmi2FreeInstance(c);
}

/* In the middle between two samples, from states that were kept: in memory and as bytes. */
static void saved_states(void)
{
    static char bytes[8192];
    void *c = stepping(0);
    void *kept = NULL;
    void *read = NULL;
    size_t size = 0;
    check(set(c, FORCE, 2.0) == STATUS_OK && fmi2DoStep(c, 0.0, 0.25, 1) == STATUS_OK, __LINE__);
    check(fmi2GetFMUstate(c, &kept) == STATUS_OK, __LINE__);
    check(fmi2SerializedFMUstateSize(c, kept, &size) == STATUS_OK && size <= sizeof bytes, __LINE__);
    check(fmi2SerializeFMUstate(c, kept, bytes, size) == STATUS_OK, __LINE__);
    check(fmi2DoStep(c, 0.25, 0.45, 1) == STATUS_OK, __LINE__);
    const double expected = get(c, POSITION);
    check(fmi2SetFMUstate(c, kept) == STATUS_OK && !same(get(c, POSITION), expected), __LINE__);
    check(fmi2DoStep(c, 0.25, 0.45, 1) == STATUS_OK && same(get(c, POSITION), expected), __LINE__);
    void *other = stepping(0);
    check(fmi2DeSerializeFMUstate(other, bytes, size, &read) == STATUS_OK, __LINE__);
    check(fmi2SetFMUstate(other, read) == STATUS_OK && fmi2DoStep(other, 0.25, 0.45, 1) == STATUS_OK, __LINE__);
    check(same(get(other, POSITION), expected), __LINE__);
    fmi2FreeFMUstate(c, &kept);
    fmi2FreeFMUstate(other, &read);
    fmi2FreeInstance(c);
    fmi2FreeInstance(other);
}

static void no_allocation(void)
{
    const uint32_t force = FORCE;
    const uint32_t position = POSITION;
    const int32_t order = 1;
    const double rate = 0.5;
    void *c = stepping(0);
    const int before = allocations;
    for (int i = 0; i < 50; i++) {
        check(fmi2SetRealInputDerivatives(c, &force, 1, &order, &rate) == STATUS_OK, __LINE__);
        check(fmi2DoStep(c, 0.03 * i, 0.03, 1) == STATUS_OK, __LINE__);
        double slope;
        check(fmi2GetDirectionalDerivative(c, &position, 1, &force, 1, &rate, &slope) == STATUS_OK, __LINE__);
        check(same(slope, 0.0), __LINE__); /* at once there is no effect */
    }
    check(allocations == before, __LINE__);
    fmi2FreeInstance(c);
}

static void no_output_derivatives(void)
{
    const uint32_t position = POSITION;
    const int32_t order = 1;
    double slope;
    void *c = stepping(0);
    check(fmi2GetRealOutputDerivatives(c, &position, 1, &order, &slope) == STATUS_ERROR, __LINE__);
    said("they are linear between samples", __LINE__);
    fmi2FreeInstance(c);
}

static void domain(void)
{
    /* said, once */
    void *c = stepping(0);
    check(set(c, FORCE, 9.0) == STATUS_OK && set(c, FORCE, 8.0) == STATUS_OK && messages == 1, __LINE__);
    said("variable `force`: 9 is outside the training range from -3 to 3; outputs are extrapolated", __LINE__);
    fmi2FreeInstance(c);
    /* clamped at the samples */
    double found[2];
    for (int i = 0; i < 2; i++) {
        c = stepping(1);
        check(set(c, FORCE, i == 0 ? 3.0 : 9.0) == STATUS_OK, __LINE__);
        check(fmi2DoStep(c, 0.0, 0.5, 1) == STATUS_OK, __LINE__);
        found[i] = get(c, POSITION);
        fmi2FreeInstance(c);
    }
    check(same(found[0], found[1]) && !same(found[0], 0.5), __LINE__);
    /* refused, and nothing has changed */
    const uint32_t force = FORCE;
    const int32_t order = 1;
    const double rate = 100.0;
    c = stepping(2);
    check(fmi2SetRealInputDerivatives(c, &force, 1, &order, &rate) == STATUS_OK, __LINE__);
    check(fmi2DoStep(c, 0.0, 0.2, 1) == STATUS_ERROR && same(get(c, POSITION), 0.5), __LINE__);
    said("fmi2DoStep: variable `force`: 20 is outside the training range from -3 to 3, and domain_policy is 2",
         __LINE__);
    fmi2FreeInstance(c);
}

int main(void)
{
    only_co_simulation();
    starts_belong_to_the_start();
    saved_states();
    no_allocation();
    no_output_derivatives();
    domain();
    return 0;
}

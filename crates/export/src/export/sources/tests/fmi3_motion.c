/*
 * FMI 3.0 with states: the crane. Its inputs are the rope's length (fixed, 1 to 2), the starts of the four states and a
 * force (-10 to 10).
 */
#include "fmi3.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { ROPE = 1, STARTS, FORCE = 6, LOAD_X = 9, STATES = 14, RATES = 18, DOMAIN_POLICY = 22, IN_DOMAIN, DISTANCE };

static char last_message[MESSAGE_SIZE];

static void logger(void *environment, fmi3Status status, const char *category, const char *message)
{
    (void)environment;
    (void)status;
    (void)category;
    snprintf(last_message, sizeof last_message, "%s", message);
}

static void check(bool good, int line)
{
    if (!good) {
        printf("line %d: not so; last message: %s\n", line, last_message);
        exit(1);
    }
}

static Status set(void *instance, uint32_t reference, double value)
{
    return fmi3SetFloat64(instance, &reference, 1, &value, 1);
}

static double get(void *instance, uint32_t reference)
{
    double value = NAN;
    check(fmi3GetFloat64(instance, &reference, 1, &value, 1) == STATUS_OK, __LINE__);
    return value;
}

static void *stepping(bool tolerance_defined, double tolerance)
{
    void *instance = fmi3InstantiateCoSimulation("crane", model_token, NULL, false, false, false, false, NULL, 0, NULL,
                                                 logger, NULL);
    check(instance != NULL && set(instance, STARTS + 1, 0.5) == STATUS_OK, __LINE__);
    check(fmi3EnterInitializationMode(instance, tolerance_defined, tolerance, 0.0, false, 0.0) == STATUS_OK, __LINE__);
    check(fmi3ExitInitializationMode(instance) == STATUS_OK, __LINE__);
    return instance;
}

static Status step(void *instance, double from, double size)
{
    bool event;
    bool terminate;
    bool early;
    double reached;
    return fmi3DoStep(instance, from, size, true, &event, &terminate, &early, &reached);
}

static void tolerances(void)
{
    double angles[3];
    for (int i = 0; i < 3; i++) {
        void *instance = stepping(i > 0, i == 1 ? 1e-3 : 1e-14);
        check(step(instance, 0.0, 0.5) == STATUS_OK, __LINE__);
        angles[i] = get(instance, STATES + 1);
        fmi3FreeInstance(instance);
    }
    /* a tolerance can only tighten the model's own, 1e-5 */
    check(fabs(angles[0] - angles[2]) < 1e-8 && fabs(angles[0] - angles[2]) > 0.0, __LINE__);
    check(!(fabs(angles[1] - angles[0]) > 0.0), __LINE__);
    void *instance = fmi3InstantiateModelExchange("crane", model_token, NULL, false, false, NULL, logger);
    check(fmi3EnterInitializationMode(instance, true, -1.0, 0.0, false, 0.0) == STATUS_ERROR, __LINE__);
    check(strstr(last_message, "tolerance -1 is negative or not finite") != NULL, __LINE__);
    fmi3FreeInstance(instance);
}

/* A step that fails may be tried again. */
static void failures(void)
{
    void *instance = fmi3InstantiateCoSimulation("crane", model_token, NULL, false, true, false, false, NULL, 0, NULL,
                                                 logger, NULL);
    double value;
    const uint32_t rate = RATES + 2;
    check(set(instance, ROPE, 0.0) == STATUS_OK, __LINE__);
    check(fmi3EnterInitializationMode(instance, false, 0.0, 0.0, false, 0.0) == STATUS_OK, __LINE__);
    check(fmi3GetFloat64(instance, &rate, 1, &value, 1) == STATUS_DISCARD, __LINE__);
    check(fmi3ExitInitializationMode(instance) == STATUS_OK && step(instance, 0.0, 0.1) == STATUS_DISCARD, __LINE__);
    check(strstr(last_message, "the states are not finite") != NULL && get(instance, STATES + 1) == 0.3, __LINE__);
    fmi3FreeInstance(instance);
    instance = stepping(false, 0.0);
    check(step(instance, 0.0, 1e9) == STATUS_ERROR, __LINE__);
    fmi3FreeInstance(instance);
}

/* ---- Intermediate updates ---- */

typedef struct {
    void *instance;
    size_t count;
    double times[32];
    double x[32];
    bool may_return[32];
    double return_at; /* asked for at the first update, unless it is not a number */
    double force;     /* set there, unless it is not a number */
    bool misuses;
} Watcher;

static void on_update(void *environment, double time, bool set_requested, bool get_allowed, bool finished,
                      bool can_return, bool *requested, double *return_time)
{
    Watcher *watcher = environment;
    const size_t i = watcher->count++;
    check(i < 32 && set_requested && get_allowed && finished && !*requested, __LINE__);
    watcher->times[i] = time;
    watcher->x[i] = get(watcher->instance, STATES);
    watcher->may_return[i] = can_return;
    if (i == 0 && watcher->force == watcher->force) {
        check(set(watcher->instance, FORCE, watcher->force) == STATUS_OK, __LINE__);
    }
    if (i == 0 && watcher->return_at == watcher->return_at) {
        *requested = true;
        *return_time = watcher->return_at;
    }
    if (watcher->misuses) {
        void *state = NULL;
        check(fmi3GetFMUState(watcher->instance, &state) == STATUS_ERROR, __LINE__);
        check(strstr(last_message, "not allowed in state `Intermediate Update Mode`") != NULL, __LINE__);
    }
}

static void watch(Watcher *watcher, bool early_return)
{
    const uint32_t required[] = {FORCE, LOAD_X, STATES, IN_DOMAIN, DISTANCE, ROPE};
    *watcher = (Watcher){.return_at = NAN, .force = NAN};
    watcher->instance = fmi3InstantiateCoSimulation("crane", model_token, NULL, false, false, false, early_return,
                                                    required, 6, watcher, logger, on_update);
    check(watcher->instance != NULL && set(watcher->instance, STARTS + 1, 0.5) == STATUS_OK, __LINE__);
    check(fmi3EnterInitializationMode(watcher->instance, false, 0.0, 0.0, false, 0.0) == STATUS_OK, __LINE__);
    check(fmi3ExitInitializationMode(watcher->instance) == STATUS_OK, __LINE__);
}

static void updates(void)
{
    Watcher watcher;
    bool event;
    bool terminate;
    bool early;
    double reached;
    void *alone = stepping(false, 0.0);
    watch(&watcher, true);
    check(step(watcher.instance, 0.0, 0.0175) == STATUS_OK && watcher.count == 4, __LINE__);
    check(watcher.times[0] == 0.004375 && watcher.times[3] == 0.0175, __LINE__);
    check(watcher.may_return[2] && !watcher.may_return[3], __LINE__);
    check(step(alone, 0.0, 0.0175) == STATUS_OK, __LINE__);
    check(fabs(get(alone, STATES) - watcher.x[3]) < 1e-15 && watcher.x[0] != watcher.x[3], __LINE__);
    fmi3FreeInstance(watcher.instance);
    fmi3FreeInstance(alone);
    /* a force from the first update on, and an early return between two others */
    watch(&watcher, true);
    watcher.force = 4.0;
    watcher.return_at = 0.0125;
    check(fmi3DoStep(watcher.instance, 0.0, 0.02, true, &event, &terminate, &early, &reached) == STATUS_OK, __LINE__);
    check(early && reached == 0.0125 && watcher.count == 3, __LINE__);
    alone = stepping(false, 0.0);
    check(step(alone, 0.0, 0.005) == STATUS_OK && set(alone, FORCE, 4.0) == STATUS_OK, __LINE__);
    check(step(alone, 0.005, 0.005) == STATUS_OK && step(alone, 0.01, 0.0025) == STATUS_OK, __LINE__);
    check(fabs(get(alone, STATES) - get(watcher.instance, STATES)) < 1e-15, __LINE__);
    fmi3FreeInstance(alone);
    fmi3FreeInstance(watcher.instance);
    /* not allowed: the whole step */
    watch(&watcher, false);
    watcher.return_at = 0.005;
    check(fmi3DoStep(watcher.instance, 0.0, 0.02, true, &event, &terminate, &early, &reached) == STATUS_OK, __LINE__);
    check(!early && reached == 0.02 && watcher.count == 4 && !watcher.may_return[0], __LINE__);
    fmi3FreeInstance(watcher.instance);
    /* a part of the step cannot be made: everything is as before */
    watch(&watcher, true);
    watcher.force = 1e307;
    check(fmi3DoStep(watcher.instance, 0.0, 0.02, true, &event, &terminate, &early, &reached) == STATUS_DISCARD,
          __LINE__);
    check(!early && reached == 0.0 && watcher.count == 1 && get(watcher.instance, FORCE) == 0.0, __LINE__);
    check(get(watcher.instance, STATES + 1) == 0.5, __LINE__);
    fmi3FreeInstance(watcher.instance);
    watch(&watcher, true);
    watcher.misuses = true;
    check(step(watcher.instance, 0.0, 0.02) == STATUS_OK && watcher.count > 0, __LINE__);
    fmi3FreeInstance(watcher.instance);
    const uint32_t wrong[] = {LOAD_X, 999};
    check(fmi3InstantiateCoSimulation("crane", model_token, NULL, false, true, false, true, wrong, 2, NULL, logger,
                                      on_update) == NULL,
          __LINE__);
    check(strstr(last_message, "value reference 999 is unknown") != NULL, __LINE__);
}

static void derivatives(void)
{
    void *instance = stepping(false, 0.0);
    const uint32_t unknowns[] = {LOAD_X, RATES + 2, STATES + 1, DISTANCE};
    const uint32_t knowns[] = {ROPE, FORCE, STATES + 1, STATES + 3, STARTS};
    const double direction[] = {0.5, -1.0, 2.0, 0.25, 7.0};
    const double weights[] = {3.0, -0.25, 0.5, 1.0};
    double along[4];
    double gradient[5];
    double left = 0.0;
    double right = 0.0;
    size_t count = 0;
    uint32_t independents[11];
    size_t elements[11];
    fmi3DependencyKind kinds[11];
    check(fmi3GetDirectionalDerivative(instance, unknowns, 4, knowns, 5, direction, 5, along, 4) == STATUS_OK,
          __LINE__);
    check(fmi3GetAdjointDerivative(instance, unknowns, 4, knowns, 5, weights, 4, gradient, 5) == STATUS_OK, __LINE__);
    for (size_t i = 0; i < 4; i++) {
        left += weights[i] * along[i];
    }
    for (size_t i = 0; i < 5; i++) {
        right += gradient[i] * direction[i];
    }
    check(fabs(left - right) < 1e-13 && fabs(left) > 1.0 && along[2] == 2.0 && gradient[4] == 0.0, __LINE__);
    check(fmi3GetNumberOfVariableDependencies(instance, RATES, &count) == STATUS_OK && count == 11, __LINE__);
    check(fmi3GetVariableDependencies(instance, RATES, elements, independents, elements, kinds, 11) == STATUS_OK,
          __LINE__);
    check(independents[0] == ROPE && independents[5] == FORCE, __LINE__);
    check(independents[6] == STATES && independents[9] == STATES + 3, __LINE__);
    check(independents[10] == DOMAIN_POLICY, __LINE__);
    check(fmi3GetNumberOfVariableDependencies(instance, STATES, &count) == STATUS_OK && count == 0, __LINE__);
    fmi3FreeInstance(instance);
}

static void solver(void)
{
    void *instance = fmi3InstantiateModelExchange("crane", model_token, NULL, false, false, NULL, logger);
    double states[4] = {0.0};
    double rates[4] = {0.0};
    double nominals[4] = {0.0};
    size_t count = 0;
    check(fmi3GetNumberOfContinuousStates(instance, &count) == STATUS_OK && count == 4, __LINE__);
    check(fmi3GetNumberOfEventIndicators(instance, &count) == STATUS_OK && count == 0, __LINE__);
    check(fmi3EnterInitializationMode(instance, false, 0.0, 0.0, false, 0.0) == STATUS_OK, __LINE__);
    check(fmi3ExitInitializationMode(instance) == STATUS_OK, __LINE__);
    check(fmi3EnterContinuousTimeMode(instance) == STATUS_OK, __LINE__);
    check(fmi3GetContinuousStates(instance, states, 4) == STATUS_OK && states[1] == 0.3, __LINE__);
    check(fmi3GetNominalsOfContinuousStates(instance, nominals, 4) == STATUS_OK && nominals[3] == 1.0, __LINE__);
    states[2] = 0.75;
    check(fmi3SetContinuousStates(instance, states, 4) == STATUS_OK, __LINE__);
    check(fmi3GetContinuousStateDerivatives(instance, rates, 4) == STATUS_OK && rates[0] == 0.75, __LINE__);
    check(get(instance, RATES + 3) == rates[3] && get(instance, STATES + 2) == 0.75, __LINE__);
    check(fmi3GetEventIndicators(instance, NULL, 0) == STATUS_OK, __LINE__);
    check(fmi3GetContinuousStates(instance, states, 5) == STATUS_ERROR, __LINE__);
    check(strstr(last_message, "argument `continuousStates`: 5 elements, expected 4") != NULL, __LINE__);
    fmi3FreeInstance(instance);
}

int main(void)
{
    tolerances();
    failures();
    updates();
    derivatives();
    solver();
    return 0;
}

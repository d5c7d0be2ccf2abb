/* A host that takes every status but OK for a failure, as solvers do with their right-hand side: FMI 2.0 and 3.0,
 * co-simulation and model exchange, of the example surrogate.
 *
 * strict LIBRARY VERSION INTERFACE RESOURCES TOKEN: VERSION is 2 or 3, INTERFACE cs or me, RESOURCES what the version
 * wants: a URI or a path. Runs from 0 s to 2 s, the end of the training range, once for each domain policy, and never
 * leaves the domain but by what a solver tries. Exits with 1 and the name of the function that did not return OK.
 */
#include <dlfcn.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LENGTH, SPEED, TIME, ANGLE, VELOCITY, DOMAIN_POLICY, IN_DOMAIN };

static const double START = 0.0, STOP = 2.0, STEP = 0.1;
/* inside the ranges, 0.1 to 0.2 and 0 to 5; one that only a solver tries */
static const double LENGTH_SET = 0.12, SPEED_SET = 1.5, SPEED_TRIED = 9.0;

static void *library;
static int version;
static bool solver;
static void *instance;

static void fail(const char *what, int status)
{
    fprintf(stderr, "strict: %s, status %d\n", what, status);
    exit(1);
}

/* ISO C has no conversion of an object pointer to a function pointer; POSIX has the bytes alike. */
static void load(const char *name, void *function)
{
    void *symbol = dlsym(library, name);
    if (symbol == NULL) fail(name, 0);
    memcpy(function, &symbol, sizeof symbol);
}

/* Calls a function of the instance by its name and the types of its arguments. */
#define CALL(name, types, ...)                        \
    do {                                              \
        int (*function) types;                        \
        load(name, &function);                        \
        const int status = function(__VA_ARGS__);     \
        if (status != 0) fail(name, status);          \
    } while (0)

#define PLAIN(name) CALL(name, (void *), instance)

/* ---- The functions that differ between the versions ---- */

typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate_memory)(size_t, size_t);
    void (*free_memory)(void *);
    void (*step_finished)(void *, int);
    void *environment;
} Callbacks;

typedef struct {
    int new_discrete_states_needed, terminate_simulation, nominals_changed, values_changed, next_event_time_defined;
    double next_event_time;
} EventInfo;

static void log_2(void *environment, const char *name, int status, const char *category, const char *format, ...)
{
    va_list arguments;
    (void)environment, (void)name, (void)status, (void)category;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
}

static void log_3(void *environment, int status, const char *category, const char *message)
{
    (void)environment, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}

static void instantiate(const char *resources, const char *token)
{
    static const Callbacks callbacks = {log_2, calloc, free, NULL, NULL};
    if (version == 2) {
        void *(*make)(const char *, int, const char *, const char *, const Callbacks *, int, int);
        load("fmi2Instantiate", &make);
        instance = make("strict", solver ? 0 : 1, token, resources, &callbacks, 0, 0);
    } else if (solver) {
        void *(*make)(const char *, const char *, const char *, bool, bool, void *, void *);
        void *logger;
        void (*function)(void *, int, const char *, const char *) = log_3;
        memcpy(&logger, &function, sizeof logger);
        load("fmi3InstantiateModelExchange", &make);
        instance = make("strict", token, resources, false, false, NULL, logger);
    } else {
        void *(*make)(const char *, const char *, const char *, bool, bool, bool, bool, const uint32_t *, size_t,
                      void *, void *, void *);
        void *logger;
        void (*function)(void *, int, const char *, const char *) = log_3;
        memcpy(&logger, &function, sizeof logger);
        load("fmi3InstantiateCoSimulation", &make);
        instance = make("strict", token, resources, false, false, true, false, NULL, 0, NULL, logger, NULL);
    }
    if (instance == NULL) fail("no instance", 0);
}

static void set_real(uint32_t reference, double value)
{
    if (version == 2) {
        CALL("fmi2SetReal", (void *, const uint32_t *, size_t, const double *), instance, &reference, 1, &value);
    } else {
        CALL("fmi3SetFloat64", (void *, const uint32_t *, size_t, const double *, size_t), instance, &reference, 1,
             &value, 1);
    }
}

static void set_policy(int32_t value)
{
    const uint32_t reference = DOMAIN_POLICY;
    if (version == 2) {
        CALL("fmi2SetInteger", (void *, const uint32_t *, size_t, const int32_t *), instance, &reference, 1, &value);
    } else {
        CALL("fmi3SetInt32", (void *, const uint32_t *, size_t, const int32_t *, size_t), instance, &reference, 1,
             &value, 1);
    }
}

static void get_outputs(void)
{
    static const uint32_t references[] = {ANGLE, VELOCITY};
    double values[2];
    if (version == 2) {
        CALL("fmi2GetReal", (void *, const uint32_t *, size_t, double *), instance, references, 2, values);
    } else {
        CALL("fmi3GetFloat64", (void *, const uint32_t *, size_t, double *, size_t), instance, references, 2, values,
             2);
    }
}

static void expect_in_domain(void)
{
    const uint32_t reference = IN_DOMAIN;
    int inside_2 = 0;
    bool inside_3 = false;
    if (version == 2) {
        CALL("fmi2GetBoolean", (void *, const uint32_t *, size_t, int *), instance, &reference, 1, &inside_2);
    } else {
        CALL("fmi3GetBoolean", (void *, const uint32_t *, size_t, bool *, size_t), instance, &reference, 1, &inside_3,
             1);
    }
    if (!inside_2 && !inside_3) fail("in_domain is false", 0);
}

static void initialize(void)
{
    if (version == 2) {
        CALL("fmi2SetupExperiment", (void *, int, double, double, int, double), instance, 1, 1e-6, START, 1, STOP);
        PLAIN("fmi2EnterInitializationMode");
        set_real(SPEED, SPEED_SET);
        get_outputs();
        PLAIN("fmi2ExitInitializationMode");
    } else {
        CALL("fmi3EnterInitializationMode", (void *, bool, double, double, bool, double), instance, true, 1e-6, START,
             true, STOP);
        set_real(SPEED, SPEED_SET);
        get_outputs();
        PLAIN("fmi3ExitInitializationMode");
    }
}

/* In Event Mode: inputs, then discrete states until nothing changes. */
static void handle_event(void)
{
    bool again = true;
    set_real(SPEED, SPEED_SET);
    while (again) {
        if (version == 2) {
            EventInfo info;
            CALL("fmi2NewDiscreteStates", (void *, EventInfo *), instance, &info);
            again = info.new_discrete_states_needed != 0;
        } else {
            bool flags[4];
            double time;
            CALL("fmi3UpdateDiscreteStates", (void *, bool *, bool *, bool *, bool *, bool *, double *), instance,
                 &again, &flags[0], &flags[1], &flags[2], &flags[3], &time);
        }
    }
    get_outputs();
}

/* ---- Model exchange ---- */

/* The right-hand side of a solver, and what a coupled system reads for it. */
static void evaluate(double time, double speed)
{
    if (version == 2) {
        CALL("fmi2SetTime", (void *, double), instance, time);
        CALL("fmi2SetContinuousStates", (void *, const double *, size_t), instance, NULL, 0);
        set_real(SPEED, speed);
        CALL("fmi2GetDerivatives", (void *, double *, size_t), instance, NULL, 0);
        CALL("fmi2GetEventIndicators", (void *, double *, size_t), instance, NULL, 0);
    } else {
        CALL("fmi3SetTime", (void *, double), instance, time);
        CALL("fmi3SetContinuousStates", (void *, const double *, size_t), instance, NULL, 0);
        set_real(SPEED, speed);
        CALL("fmi3GetContinuousStateDerivatives", (void *, double *, size_t), instance, NULL, 0);
        CALL("fmi3GetEventIndicators", (void *, double *, size_t), instance, NULL, 0);
    }
    get_outputs();
}

static void accept_step(double time)
{
    evaluate(time, SPEED_SET);
    if (version == 2) {
        int enter, terminate;
        CALL("fmi2CompletedIntegratorStep", (void *, int, int *, int *), instance, 0, &enter, &terminate);
    } else {
        bool enter, terminate;
        CALL("fmi3CompletedIntegratorStep", (void *, bool, bool *, bool *), instance, false, &enter, &terminate);
    }
    expect_in_domain();
}

static void solve(void)
{
    const int steps = (int)(STOP / STEP + 0.5);
    handle_event();
    PLAIN(version == 2 ? "fmi2EnterContinuousTimeMode" : "fmi3EnterContinuousTimeMode");
    for (int step = 0; step < steps; step++) {
        const double time = START + STEP * step;
        evaluate(time, SPEED_SET);
        evaluate(time + 20.0 * STEP, SPEED_SET); /* a step that is rejected, past the stop time soon */
        evaluate(time + STEP, SPEED_TRIED);      /* another one */
        evaluate(time, SPEED_SET);               /* back in time */
        evaluate(time + 0.5 * STEP, SPEED_SET);
        accept_step(time + STEP);
        evaluate(time + 0.7 * STEP, SPEED_SET); /* an event is looked for in the step */
        if (step % 5 == 4) {
            evaluate(time + STEP, SPEED_SET);
            PLAIN(version == 2 ? "fmi2EnterEventMode" : "fmi3EnterEventMode");
            handle_event();
            PLAIN(version == 2 ? "fmi2EnterContinuousTimeMode" : "fmi3EnterContinuousTimeMode");
        }
    }
    evaluate(3.81, SPEED_SET); /* as CVode does at a stop time of 2 s */
    accept_step(STOP);
}

/* ---- Co-simulation ---- */

static void do_steps(void)
{
    const int steps = (int)(STOP / STEP + 0.5);
    if (version == 3) {
        handle_event();
        PLAIN("fmi3EnterStepMode");
    }
    double time = START;
    for (int step = 0; step < steps; step++) {
        set_real(SPEED, SPEED_SET);
        if (version == 2) {
            CALL("fmi2DoStep", (void *, double, double, int), instance, time, STEP, 1);
        } else {
            bool event, terminate, early;
            double reached;
            CALL("fmi3DoStep", (void *, double, double, bool, bool *, bool *, bool *, double *), instance, time, STEP,
                 true, &event, &terminate, &early, &reached);
        }
        time += STEP; /* which rounding takes past the stop time */
        get_outputs();
        expect_in_domain();
        if (version == 3 && step % 5 == 4) {
            PLAIN("fmi3EnterEventMode");
            handle_event();
            PLAIN("fmi3EnterStepMode");
        }
    }
}

int main(int argc, char **argv)
{
    if (argc != 6) fail("expected LIBRARY 2|3 cs|me RESOURCES TOKEN", 0);
    library = dlopen(argv[1], RTLD_NOW | RTLD_LOCAL);
    if (library == NULL) fail(dlerror(), 0);
    version = atoi(argv[2]);
    solver = strcmp(argv[3], "me") == 0;
    instantiate(argv[4], argv[5]);
    for (int32_t policy = 0; policy < 3; policy++) {
        set_real(LENGTH, LENGTH_SET);
        set_policy(policy);
        initialize();
        if (solver) {
            solve();
        } else {
            do_steps();
        }
        PLAIN(version == 2 ? "fmi2Terminate" : "fmi3Terminate");
        PLAIN(version == 2 ? "fmi2Reset" : "fmi3Reset");
    }
    void (*release)(void *);
    load(version == 2 ? "fmi2FreeInstance" : "fmi3FreeInstance", &release);
    release(instance);
    dlclose(library);
    return 0;
}

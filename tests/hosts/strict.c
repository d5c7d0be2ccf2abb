/* A host that takes every status but OK for a failure, as solvers do with their right-hand side: FMI 2.0 and 3.0,
 * co-simulation and model exchange, of an example surrogate.
 *
 * strict LIBRARY VERSION INTERFACE RESOURCES TOKEN MODEL
 *
 * VERSION is 2 or 3, INTERFACE is cs or me, and RESOURCES is a URI for version 2, a path for version 3. MODEL is response
 * or motion, which has states and an input that changes at events. Runs from 0 s to 2 s, once for each domain policy,
 * leaves the domain by trial values of a solver only, and prints the final outputs. A further run by policy 0 leaves the
 * domain for good. On failure, exits with 1 and the name of the function that did not return OK.
 */
#include <dlfcn.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_STATES = 4, OUTPUTS = 2, PARTS = 4, STEPS = 100 };

static const double START = 0.0, STOP = 2.0, STEP = 0.02;

typedef struct {
    const char *name;
    /* value references */
    uint32_t parameter, input, outputs[OUTPUTS], domain_policy, in_domain;
    size_t states;
    /* inside the ranges; of the input in equal parts of the run, one that only a solver tries, and one outside */
    double parameter_set, input_set[PARTS], input_tried, input_outside;
} Model;

static const Model models[] = {
    {"response", 1, 2, {4, 5}, 6, 7, 0, 0.12, {1.5, 1.5, 1.5, 1.5}, 9.0, 6.0},
    {"motion", 1, 6, {7, 8}, 22, 23, 4, 1.3, {4.0, -6.0, 8.0, -3.0}, 90.0, 11.0},
};

static const Model *model;
static void *library;
static int version;
static bool solver;
static void *instance;
/* true if the run leaves the domain; true if in_domain reported it; number of warnings in the log */
static bool leaves, has_left;
static int warnings;

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
    (void)environment, (void)name, (void)category;
    if (status == 1 && leaves) {
        warnings++;
        return;
    }
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

/* The input from the beginning of a step on. */
static double input_at(int step)
{
    if (leaves && step >= STEPS / 2) return model->input_outside;
    return model->input_set[step < STEPS ? PARTS * step / STEPS : PARTS - 1];
}

static bool is_event(int step)
{
    return step % (STEPS / PARTS) == 0;
}

static void set_policy(int32_t value)
{
    const uint32_t reference = model->domain_policy;
    if (version == 2) {
        CALL("fmi2SetInteger", (void *, const uint32_t *, size_t, const int32_t *), instance, &reference, 1, &value);
    } else {
        CALL("fmi3SetInt32", (void *, const uint32_t *, size_t, const int32_t *, size_t), instance, &reference, 1,
             &value, 1);
    }
}

static void get_outputs(double values[OUTPUTS])
{
    if (version == 2) {
        CALL("fmi2GetReal", (void *, const uint32_t *, size_t, double *), instance, model->outputs, OUTPUTS, values);
    } else {
        CALL("fmi3GetFloat64", (void *, const uint32_t *, size_t, double *, size_t), instance, model->outputs, OUTPUTS,
             values, OUTPUTS);
    }
}

static void check_in_domain(void)
{
    const uint32_t reference = model->in_domain;
    int inside_2 = 0;
    bool inside_3 = false;
    if (version == 2) {
        CALL("fmi2GetBoolean", (void *, const uint32_t *, size_t, int *), instance, &reference, 1, &inside_2);
    } else {
        CALL("fmi3GetBoolean", (void *, const uint32_t *, size_t, bool *, size_t), instance, &reference, 1, &inside_3,
             1);
    }
    if (inside_2 || inside_3) return;
    if (!leaves) fail("in_domain is false", 0);
    has_left = true;
}

static void initialize(void)
{
    double outputs[OUTPUTS];
    if (version == 2) {
        CALL("fmi2SetupExperiment", (void *, int, double, double, int, double), instance, 1, 1e-6, START, 1, STOP);
        PLAIN("fmi2EnterInitializationMode");
        set_real(model->input, input_at(0));
        get_outputs(outputs);
        PLAIN("fmi2ExitInitializationMode");
    } else {
        CALL("fmi3EnterInitializationMode", (void *, bool, double, double, bool, double), instance, true, 1e-6, START,
             true, STOP);
        set_real(model->input, input_at(0));
        get_outputs(outputs);
        PLAIN("fmi3ExitInitializationMode");
    }
}

/* In Event Mode: inputs, then discrete states until nothing changes. */
static void handle_event(int step)
{
    bool again = true;
    double outputs[OUTPUTS];
    set_real(model->input, input_at(step));
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
    get_outputs(outputs);
}

/* ---- Model exchange ---- */

static void get_states(double x[MOST_STATES])
{
    CALL(version == 2 ? "fmi2GetContinuousStates" : "fmi3GetContinuousStates", (void *, double *, size_t), instance, x,
         model->states);
}

/* The right-hand side of a solver, and what a coupled system reads for it. */
static void evaluate(double time, const double x[MOST_STATES], double input, double rates[MOST_STATES])
{
    double outputs[OUTPUTS];
    /* as hosts do where there are none */
    const double *const states = model->states > 0 ? x : NULL;
    double *const derivatives = model->states > 0 ? rates : NULL;
    if (version == 2) {
        CALL("fmi2SetTime", (void *, double), instance, time);
        CALL("fmi2SetContinuousStates", (void *, const double *, size_t), instance, states, model->states);
        set_real(model->input, input);
        CALL("fmi2GetDerivatives", (void *, double *, size_t), instance, derivatives, model->states);
        CALL("fmi2GetEventIndicators", (void *, double *, size_t), instance, NULL, 0);
    } else {
        CALL("fmi3SetTime", (void *, double), instance, time);
        CALL("fmi3SetContinuousStates", (void *, const double *, size_t), instance, states, model->states);
        set_real(model->input, input);
        CALL("fmi3GetContinuousStateDerivatives", (void *, double *, size_t), instance, derivatives, model->states);
        CALL("fmi3GetEventIndicators", (void *, double *, size_t), instance, NULL, 0);
    }
    get_outputs(outputs);
}

/* A step of the classical Runge-Kutta method. */
static void integrate(double time, double x[MOST_STATES], double input)
{
    static const double share[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
    double rates[MOST_STATES] = {0}, tried[MOST_STATES], next[MOST_STATES];
    memcpy(next, x, sizeof next);
    for (int stage = 0; stage < 4; stage++) {
        for (size_t i = 0; i < model->states; i++) tried[i] = x[i] + share[stage] * STEP * rates[i];
        evaluate(time + share[stage] * STEP, tried, input, rates);
        for (size_t i = 0; i < model->states; i++) next[i] += weight[stage] * STEP * rates[i];
    }
    memcpy(x, next, sizeof next);
}

static void accept_step(double time, const double x[MOST_STATES], double input)
{
    double rates[MOST_STATES];
    evaluate(time, x, input, rates);
    if (version == 2) {
        int enter, terminate;
        CALL("fmi2CompletedIntegratorStep", (void *, int, int *, int *), instance, 0, &enter, &terminate);
    } else {
        bool enter, terminate;
        CALL("fmi3CompletedIntegratorStep", (void *, bool, bool *, bool *), instance, false, &enter, &terminate);
    }
    check_in_domain();
}

static void solve(void)
{
    static const double far[MOST_STATES] = {50.0, 2.0, -9.0, 30.0};
    double x[MOST_STATES], rates[MOST_STATES];
    handle_event(0);
    PLAIN(version == 2 ? "fmi2EnterContinuousTimeMode" : "fmi3EnterContinuousTimeMode");
    get_states(x);
    for (int step = 0; step < STEPS; step++) {
        const double time = START + STEP * step, input = input_at(step);
        evaluate(time, x, input, rates);
        evaluate(time + 100.0 * STEP, far, input, rates);    /* a step that is rejected, past the stop time soon */
        evaluate(time + STEP, x, model->input_tried, rates); /* another one */
        evaluate(time, x, input, rates);                     /* back in time */
        integrate(time, x, input);
        accept_step(time + STEP, x, input);
        evaluate(time + 0.7 * STEP, x, input, rates); /* search for an event in the step */
        if (is_event(step + 1)) {
            evaluate(time + STEP, x, input, rates);
            PLAIN(version == 2 ? "fmi2EnterEventMode" : "fmi3EnterEventMode");
            handle_event(step + 1);
            PLAIN(version == 2 ? "fmi2EnterContinuousTimeMode" : "fmi3EnterContinuousTimeMode");
            get_states(x);
        }
    }
    evaluate(3.81, far, input_at(STEPS), rates); /* as CVode does at a stop time of 2 s */
    accept_step(STOP, x, input_at(STEPS));
}

/* ---- Co-simulation ---- */

static void do_steps(void)
{
    double outputs[OUTPUTS], time = START;
    if (version == 3) {
        handle_event(0);
        PLAIN("fmi3EnterStepMode");
    }
    for (int step = 0; step < STEPS; step++) {
        set_real(model->input, input_at(step));
        if (version == 2) {
            CALL("fmi2DoStep", (void *, double, double, int), instance, time, STEP, 1);
        } else {
            bool event, terminate, early;
            double reached;
            CALL("fmi3DoStep", (void *, double, double, bool, bool *, bool *, bool *, double *), instance, time, STEP,
                 true, &event, &terminate, &early, &reached);
        }
        time += STEP; /* which rounding takes past the stop time */
        get_outputs(outputs);
        check_in_domain();
        if (version == 3 && is_event(step + 1)) {
            PLAIN("fmi3EnterEventMode");
            handle_event(step + 1);
            PLAIN("fmi3EnterStepMode");
        }
    }
}

int main(int argc, char **argv)
{
    if (argc != 7) fail("expected LIBRARY 2|3 cs|me RESOURCES TOKEN response|motion", 0);
    library = dlopen(argv[1], RTLD_NOW | RTLD_LOCAL);
    if (library == NULL) fail(dlerror(), 0);
    version = atoi(argv[2]);
    solver = strcmp(argv[3], "me") == 0;
    model = &models[strcmp(argv[6], models[1].name) == 0];
    instantiate(argv[4], argv[5]);
    for (int run = 0; run < 4; run++) {
        double outputs[OUTPUTS];
        leaves = run == 3;
        set_real(model->parameter, model->parameter_set);
        set_policy(leaves ? 0 : run);
        initialize();
        if (solver) {
            solve();
        } else {
            do_steps();
        }
        get_outputs(outputs);
        if (!leaves) printf("%.17g %.17g\n", outputs[0], outputs[1]);
        PLAIN(version == 2 ? "fmi2Terminate" : "fmi3Terminate");
        PLAIN(version == 2 ? "fmi2Reset" : "fmi3Reset");
    }
    if (!has_left) fail("in_domain stays true", 0);
    if (version == 2 && warnings == 0) fail("no warning is logged", 0); /* FMI 3.0 logs only on request */
    void (*release)(void *);
    load(version == 2 ? "fmi2FreeInstance" : "fmi3FreeInstance", &release);
    release(instance);
    dlclose(library);
    return 0;
}

/*
 * A load on a spring and a damper, as an FMI 2.0 co-simulation FMU.
 *
 * The load of mass `m` stands on a carriage that moves with the acceleration `a`. With its displacement q relative to the
 * carriage
 *
 *     m qdd = -k q - d qd - m a
 *
 * and the force on the carriage is k q + d qd. `a` is the input and keeps its value during a communication step. The
 * equation is integrated by the classical Runge-Kutta method in equal steps of at most 1 ms.
 *
 * Value references are those of modelDescription.xml. Build it with ../build.py.
 */
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

/* ---- What fmi2TypesPlatform.h and fmi2FunctionTypes.h declare, as far as it is needed ----------------------------- */

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef int fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment environment;
} fmi2CallbackFunctions;

#define FMI2_EXPORT __attribute__((visibility("default")))

/* ---- The model ---------------------------------------------------------------------------------------------------- */

#define TOKEN "{6b0e3a52-8c1f-4f0e-9a35-1d1c6f0a7e11}"
#define LONGEST_STEP 1e-3

enum { MASS, STIFFNESS, DAMPING, ACCELERATION, DISPLACEMENT, VELOCITY, FORCE, VALUES };

typedef enum { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED } State;

typedef struct {
    State state;
    double time;
    double values[VALUES];
    const fmi2CallbackFunctions *callbacks;
    char *name;
} Load;

static void start_values(Load *load) {
    const double start[VALUES] = {[MASS] = 10.0, [STIFFNESS] = 4000.0, [DAMPING] = 40.0};
    memcpy(load->values, start, sizeof start);
    load->state = INSTANTIATED;
    load->time = 0.0;
}

static double relative_acceleration(const double *v, double q, double qd) {
    return -(v[STIFFNESS] * q + v[DAMPING] * qd) / v[MASS] - v[ACCELERATION];
}

static void integrate(double *v, double duration) {
    const int steps = (int)ceil(duration / LONGEST_STEP);
    const double h = duration / steps;
    double q = v[DISPLACEMENT], qd = v[VELOCITY];
    for (int step = 0; step < steps; step++) {
        const double q1 = qd, p1 = relative_acceleration(v, q, qd);
        const double q2 = qd + h / 2 * p1, p2 = relative_acceleration(v, q + h / 2 * q1, q2);
        const double q3 = qd + h / 2 * p2, p3 = relative_acceleration(v, q + h / 2 * q2, q3);
        const double q4 = qd + h * p3, p4 = relative_acceleration(v, q + h * q3, q4);
        q += h / 6 * (q1 + 2 * q2 + 2 * q3 + q4);
        qd += h / 6 * (p1 + 2 * p2 + 2 * p3 + p4);
    }
    v[DISPLACEMENT] = q;
    v[VELOCITY] = qd;
}

static fmi2Status refuse(const Load *load, const char *message) {
    const fmi2CallbackFunctions *callbacks = load->callbacks;
    if (callbacks && callbacks->logger) {
        callbacks->logger(callbacks->environment, load->name, fmi2Error, "logStatusError", "%s", message);
    }
    return fmi2Error;
}

/* ---- Instances ---------------------------------------------------------------------------------------------------- */

FMI2_EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI2_EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

FMI2_EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                                          const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                                          fmi2Boolean logging) {
    (void)resources, (void)visible, (void)logging;
    if (!name || !token || type != fmi2CoSimulation || strcmp(token, TOKEN) != 0) return NULL;
    Load *load = malloc(sizeof *load);
    char *copy = malloc(strlen(name) + 1);
    if (!load || !copy) {
        free(load);
        free(copy);
        return NULL;
    }
    load->callbacks = callbacks;
    load->name = strcpy(copy, name);
    start_values(load);
    return load;
}

FMI2_EXPORT void fmi2FreeInstance(fmi2Component component) {
    Load *load = component;
    if (!load) return;
    free(load->name);
    free(load);
}

FMI2_EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t n, const fmi2String names[]) {
    (void)on, (void)n, (void)names;
    return component ? fmi2OK : fmi2Error;
}

static fmi2Status advance(fmi2Component component, State from, State to) {
    Load *load = component;
    if (!load) return fmi2Error;
    if (load->state != from) return refuse(load, "called in the wrong state");
    load->state = to;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean has_tolerance, fmi2Real tolerance,
                                           fmi2Real start, fmi2Boolean has_stop, fmi2Real stop) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    Load *load = component;
    if (!load) return fmi2Error;
    if (!isfinite(start)) return refuse(load, "the start time is not finite");
    load->time = start;
    return advance(component, INSTANTIATED, INSTANTIATED);
}

FMI2_EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return advance(c, INSTANTIATED, INITIALIZING); }
FMI2_EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return advance(c, INITIALIZING, STEPPING); }
FMI2_EXPORT fmi2Status fmi2Terminate(fmi2Component c) { return advance(c, STEPPING, TERMINATED); }

FMI2_EXPORT fmi2Status fmi2Reset(fmi2Component component) {
    if (!component) return fmi2Error;
    start_values(component);
    return fmi2OK;
}

/* ---- Values ------------------------------------------------------------------------------------------------------- */

FMI2_EXPORT fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference references[], size_t n,
                                   fmi2Real values[]) {
    Load *load = component;
    if (!load || (n > 0 && (!references || !values))) return fmi2Error;
    const double *v = load->values;
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= VALUES) return refuse(load, "no such variable");
        // computed when asked for: no delay after a parameter was set
        values[i] = references[i] == FORCE ? v[STIFFNESS] * v[DISPLACEMENT] + v[DAMPING] * v[VELOCITY] : v[references[i]];
    }
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference references[], size_t n,
                                   const fmi2Real values[]) {
    Load *load = component;
    if (!load || (n > 0 && (!references || !values))) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        const int start = references[i] == DISPLACEMENT || references[i] == VELOCITY;
        if (references[i] > ACCELERATION && !(start && load->state < STEPPING)) {
            return refuse(load, "neither a parameter, an input nor a start value");
        }
        if (!isfinite(values[i])) return refuse(load, "the value is not finite");
        if (references[i] == MASS && values[i] <= 0.0) return refuse(load, "the mass must be above zero");
    }
    for (size_t i = 0; i < n; i++) load->values[references[i]] = values[i];
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real step, fmi2Boolean no_state_prior) {
    (void)no_state_prior;
    Load *load = component;
    if (!load) return fmi2Error;
    if (load->state != STEPPING) return refuse(load, "fmi2DoStep outside of the simulation");
    if (!(step > 0.0 && step <= 1e3)) return refuse(load, "the step size must be above zero and at most 1000 s");
    // a host that adds up its steps may be off by rounding
    if (!(fabs(time - load->time) <= 1e-9 * (1.0 + fabs(time)))) {
        return refuse(load, "the step does not begin where the last ended");
    }
    integrate(load->values, step);
    load->time = time + step;
    return fmi2OK;
}

/* ---- What this FMU does not offer: hosts load these functions, modelDescription.xml keeps them from calling ----------- */

#define NOT_OFFERED(function, ...) \
    FMI2_EXPORT fmi2Status function(fmi2Component component, __VA_ARGS__) { \
        return component ? refuse(component, #function " is not offered") : fmi2Error; \
    }
// their parameters are there for the signature alone
#pragma GCC diagnostic ignored "-Wunused-parameter"

NOT_OFFERED(fmi2GetInteger, const fmi2ValueReference *references, size_t n, fmi2Integer *values)
NOT_OFFERED(fmi2GetBoolean, const fmi2ValueReference *references, size_t n, fmi2Boolean *values)
NOT_OFFERED(fmi2GetString, const fmi2ValueReference *references, size_t n, fmi2String *values)
NOT_OFFERED(fmi2SetInteger, const fmi2ValueReference *references, size_t n, const fmi2Integer *values)
NOT_OFFERED(fmi2SetBoolean, const fmi2ValueReference *references, size_t n, const fmi2Boolean *values)
NOT_OFFERED(fmi2SetString, const fmi2ValueReference *references, size_t n, const fmi2String *values)
NOT_OFFERED(fmi2GetFMUstate, fmi2FMUstate *state)
NOT_OFFERED(fmi2SetFMUstate, fmi2FMUstate state)
NOT_OFFERED(fmi2FreeFMUstate, fmi2FMUstate *state)
NOT_OFFERED(fmi2SerializedFMUstateSize, fmi2FMUstate state, size_t *size)
NOT_OFFERED(fmi2SerializeFMUstate, fmi2FMUstate state, fmi2Byte *bytes, size_t size)
NOT_OFFERED(fmi2DeSerializeFMUstate, const fmi2Byte *bytes, size_t size, fmi2FMUstate *state)
NOT_OFFERED(fmi2GetDirectionalDerivative, const fmi2ValueReference *unknowns, size_t n, const fmi2ValueReference *knowns,
            size_t m, const fmi2Real *seed, fmi2Real *derivative)
NOT_OFFERED(fmi2SetRealInputDerivatives, const fmi2ValueReference *references, size_t n, const fmi2Integer *order,
            const fmi2Real *values)
NOT_OFFERED(fmi2GetRealOutputDerivatives, const fmi2ValueReference *references, size_t n, const fmi2Integer *order,
            fmi2Real *values)
NOT_OFFERED(fmi2GetStatus, const fmi2StatusKind kind, fmi2Status *value)
NOT_OFFERED(fmi2GetRealStatus, const fmi2StatusKind kind, fmi2Real *value)
NOT_OFFERED(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
NOT_OFFERED(fmi2GetBooleanStatus, const fmi2StatusKind kind, fmi2Boolean *value)
NOT_OFFERED(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)

FMI2_EXPORT fmi2Status fmi2CancelStep(fmi2Component component) {
    return component ? refuse(component, "fmi2CancelStep is not offered") : fmi2Error;
}

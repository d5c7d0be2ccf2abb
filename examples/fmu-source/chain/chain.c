/*
 * Three masses in a row, each on a spring and a damper to the one before and the first to a wall, as an FMI 3.0
 * co-simulation FMU with an array for an output. A force pulls the last mass.
 *
 *     m q_i'' = f_i - f_(i+1),  f_i = k (q_(i-1) - q_i) + d (q_(i-1)' - q_i'),  q_0 = 0,  f_4 = -force
 *
 * Integrated by the classical Runge-Kutta method in equal steps of at most 1 ms. Value references are those of
 * modelDescription.xml. Build it with ../build.py.
 */
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#define API __attribute__((visibility("default")))
#define TOKEN "{7d1b0c86-5a3e-4b63-8a0e-8f5a1f7c2b90}"
#define LONGEST_STEP 1e-3

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
enum { MASSES = 3, STATES = 2 * MASSES };
enum { MASS, STIFFNESS, DAMPING, FORCE, POSITION, ENERGY };
typedef struct {
    double parameters[POSITION];
    double state[STATES]; /* positions, then velocities */
} Chain;

static void derivative(const Chain *chain, const double *state, double *result) {
    const double *p = chain->parameters, *q = state, *qd = state + MASSES;
    double pull = -p[FORCE];
    for (int i = MASSES - 1; i >= 0; i--) {
        const double before = i ? q[i - 1] : 0.0, before_d = i ? qd[i - 1] : 0.0;
        const double spring = p[STIFFNESS] * (before - q[i]) + p[DAMPING] * (before_d - qd[i]);
        result[i] = qd[i];
        result[MASSES + i] = (spring - pull) / p[MASS];
        pull = spring;
    }
}

static void integrate(Chain *chain, double duration) {
    const int steps = (int)ceil(duration / LONGEST_STEP - 1e-9);
    const double h = duration / steps, share[] = {0.0, h / 2, h / 2, h}, weight[] = {h / 6, h / 3, h / 3, h / 6};
    for (int step = 0; step < steps; step++) {
        double slope[STATES] = {0}, at[STATES], sum[STATES];
        memcpy(sum, chain->state, sizeof sum);
        for (int stage = 0; stage < 4; stage++) {
            for (int i = 0; i < STATES; i++) at[i] = chain->state[i] + share[stage] * slope[i];
            derivative(chain, at, slope);
            for (int i = 0; i < STATES; i++) sum[i] += weight[stage] * slope[i];
        }
        memcpy(chain->state, sum, sizeof sum);
    }
}

static double energy(const Chain *chain) {
    const double *p = chain->parameters, *q = chain->state;
    double sum = 0.0;
    for (int i = 0; i < MASSES; i++) {
        const double stretch = q[i] - (i ? q[i - 1] : 0.0), speed = q[MASSES + i];
        sum += 0.5 * p[STIFFNESS] * stretch * stretch + 0.5 * p[MASS] * speed * speed;
    }
    return sum;
}

API const char *fmi3GetVersion(void) { return "3.0"; }

API Status fmi3Reset(void *instance) {
    static const Chain start = {{1.0, 100.0, 1.0, 10.0}, {0.0}};
    *(Chain *)instance = start;
    return OK;
}

API void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible, bool logging,
                                      bool events, bool early_return, const unsigned *intermediate, size_t count,
                                      void *environment, void *logger, void *update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early_return;
    (void)intermediate, (void)count, (void)environment, (void)logger, (void)update;
    if (!token || strcmp(token, TOKEN) != 0) return NULL;
    Chain *chain = malloc(sizeof *chain);
    if (chain) fmi3Reset(chain);
    return chain;
}

API void fmi3FreeInstance(void *instance) { free(instance); }

API Status fmi3EnterInitializationMode(void *instance, bool has_tolerance, double tolerance, double start, bool has_stop,
                                       double stop) {
    (void)has_tolerance, (void)tolerance, (void)start, (void)has_stop, (void)stop;
    return instance ? OK : ERROR;
}

API Status fmi3ExitInitializationMode(void *instance) { return instance ? OK : ERROR; }
API Status fmi3Terminate(void *instance) { return instance ? OK : ERROR; }

API Status fmi3GetFloat64(void *instance, const unsigned references[], size_t n, double values[], size_t n_values) {
    const Chain *chain = instance;
    size_t next = 0;
    for (size_t i = 0; i < n; i++) {
        const size_t size = references[i] == POSITION ? MASSES : 1;
        if (references[i] > ENERGY || next + size > n_values) return ERROR;
        if (references[i] == POSITION) memcpy(values + next, chain->state, MASSES * sizeof *values);
        else values[next] = references[i] == ENERGY ? energy(chain) : chain->parameters[references[i]];
        next += size;
    }
    return OK;
}

API Status fmi3SetFloat64(void *instance, const unsigned references[], size_t n, const double values[], size_t n_values) {
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= POSITION || i >= n_values) return ERROR;
        ((Chain *)instance)->parameters[references[i]] = values[i];
    }
    return OK;
}

API Status fmi3DoStep(void *instance, double time, double step, bool no_state_prior, bool *event, bool *terminate,
                      bool *early, double *last) {
    (void)no_state_prior;
    if (!(step > 0)) return ERROR;
    integrate(instance, step);
    *event = *terminate = *early = false;
    *last = time + step;
    return OK;
}

/* Functions that hosts load, for features that modelDescription.xml does not offer. */
#define NOT_OFFERED(function) API Status function(void *instance) { (void)instance; return ERROR; }
NOT_OFFERED(fmi3SetDebugLogging) NOT_OFFERED(fmi3GetBoolean) NOT_OFFERED(fmi3SetBoolean)
NOT_OFFERED(fmi3GetFloat32) NOT_OFFERED(fmi3SetFloat32) NOT_OFFERED(fmi3GetInt8) NOT_OFFERED(fmi3SetInt8)
NOT_OFFERED(fmi3GetUInt8) NOT_OFFERED(fmi3SetUInt8) NOT_OFFERED(fmi3GetInt16) NOT_OFFERED(fmi3SetInt16)
NOT_OFFERED(fmi3GetUInt16) NOT_OFFERED(fmi3SetUInt16) NOT_OFFERED(fmi3GetInt32) NOT_OFFERED(fmi3SetInt32)
NOT_OFFERED(fmi3GetUInt32) NOT_OFFERED(fmi3SetUInt32) NOT_OFFERED(fmi3GetInt64) NOT_OFFERED(fmi3SetInt64)
NOT_OFFERED(fmi3GetUInt64) NOT_OFFERED(fmi3SetUInt64) NOT_OFFERED(fmi3GetString) NOT_OFFERED(fmi3SetString)
NOT_OFFERED(fmi3GetBinary) NOT_OFFERED(fmi3SetBinary) NOT_OFFERED(fmi3GetClock) NOT_OFFERED(fmi3SetClock)
NOT_OFFERED(fmi3EnterConfigurationMode) NOT_OFFERED(fmi3ExitConfigurationMode) NOT_OFFERED(fmi3EnterEventMode)
NOT_OFFERED(fmi3EnterStepMode) NOT_OFFERED(fmi3GetFMUState) NOT_OFFERED(fmi3SetFMUState) NOT_OFFERED(fmi3FreeFMUState)
NOT_OFFERED(fmi3SerializedFMUStateSize) NOT_OFFERED(fmi3SerializeFMUState) NOT_OFFERED(fmi3DeserializeFMUState)
NOT_OFFERED(fmi3GetDirectionalDerivative) NOT_OFFERED(fmi3GetAdjointDerivative) NOT_OFFERED(fmi3GetOutputDerivatives)
NOT_OFFERED(fmi3GetNumberOfVariableDependencies) NOT_OFFERED(fmi3GetVariableDependencies)
NOT_OFFERED(fmi3GetIntervalDecimal) NOT_OFFERED(fmi3GetIntervalFraction) NOT_OFFERED(fmi3GetShiftDecimal)
NOT_OFFERED(fmi3GetShiftFraction) NOT_OFFERED(fmi3SetIntervalDecimal) NOT_OFFERED(fmi3SetIntervalFraction)
NOT_OFFERED(fmi3SetShiftDecimal) NOT_OFFERED(fmi3SetShiftFraction) NOT_OFFERED(fmi3EvaluateDiscreteStates)
NOT_OFFERED(fmi3UpdateDiscreteStates)

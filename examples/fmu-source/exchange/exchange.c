/*
 * Eight models in the manner of the Reference FMUs, for model exchange only. ../exchange.py builds them:
 *
 *     cc -DMODEL=BALL -DFMI=2 ...
 *
 *     DAHLQUIST     x' = -k x + u; wants an event after every step
 *     VAN_DER_POL   x0' = x1, x1' = mu (1 - x0^2) x1 - x0
 *     BALL          h' = v, v' = -9.81; where h = 0, v becomes -e v: state events
 *     STAIR         counter grows by 1 every `period`: time events; `limit` ends the simulation
 *     TANK          h' = -sqrt(h); a negative h is discarded, at h = 1e-4 the simulation ends
 *     STICK_SLIP    a mass on a spring and on a belt of speed b: x' = v, m v' = -k x + friction; it sticks up to the force
 *                   `stick` and slips with the force `slip`; state events change the mode
 *     RELAY         x' = -x + u, y' = -k (y - x), stiff; where x leaves -band to band, u = 2 or -2 changes its sign: state events
 *     GATE          x' = -k (x - sin t) + cos t, stiff, so that x = sin t; counts how often x passes the ends of 0.5 -/+ w: state events
 *
 * VAN_DER_POL and RELAY have directional derivatives; -DWRONG makes them 0. If the environment variable EXCHANGE_COUNTS names a file,
 * an instance that is freed appends its numbers of evaluated derivatives and directional derivatives.
 *
 * Variables are numbers in an array: the time, parameters and inputs, states, derivatives, outputs; value references are
 * positions in it. Start values are set by the host, or else by fmiReset and at instantiation.
 */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define API __attribute__((visibility("default")))
#define DAHLQUIST 1
#define VAN_DER_POL 2
#define BALL 3
#define STAIR 4
#define TANK 5
#define STICK_SLIP 6
#define RELAY 7
#define GATE 8

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
typedef unsigned Reference;

#if MODEL == DAHLQUIST
enum { TIME, K, START, U, X, DER_X, VARIABLES, STATES = 1, STATE = X, INDICATORS = 0 };
static const double STARTS[] = {0, 1, 1, 0, 1, 0};
#elif MODEL == VAN_DER_POL
enum { TIME, MU, START, X0, X1, DER_X0, DER_X1, VARIABLES, STATES = 2, STATE = X0, INDICATORS = 0 };
static const double STARTS[] = {0, 1, 2, 2, 0, 0, 0};
#elif MODEL == BALL
enum { TIME, E, START, H, V, DER_H, DER_V, VARIABLES, STATES = 2, STATE = H, INDICATORS = 1 };
static const double STARTS[] = {0, 0.7, 1, 1, 0, 0, 0};
#elif MODEL == STAIR
enum { TIME, PERIOD, LIMIT, COUNTER, VARIABLES, STATES = 0, STATE = VARIABLES, INDICATORS = 0 };
static const double STARTS[] = {0, 0.25, 1000, 0};
#elif MODEL == STICK_SLIP
enum { TIME, STIFFNESS, B, STICK, SLIP, X, V, DER_X, DER_V, VARIABLES, STATES = 2, STATE = X, INDICATORS = 1 };
static const double STARTS[] = {0, 20, 0.5, 4, 2, 0, 0, 0, 0};
#elif MODEL == RELAY
enum { TIME, K, BAND, X, Y, DER_X, DER_Y, VARIABLES, STATES = 2, STATE = X, INDICATORS = 1 };
static const double STARTS[] = {0, 1e6, 1, 0, 0, 0, 0};
#elif MODEL == GATE
enum { TIME, K, W, X, DER_X, PASSES, VARIABLES, STATES = 1, STATE = X, INDICATORS = 1 };
static const double STARTS[] = {0, 1e6, 0.35, 0, 0, 0};
#else
enum { TIME, START, H, DER_H, VARIABLES, STATES = 1, STATE = H, INDICATORS = 1 };
static const double STARTS[] = {0, 1, 1, 0};
#endif
enum { DERIVATIVE = STATE + STATES };

typedef struct {
    double v[VARIABLES];
    bool terminate, has_next;
    double next;
    /* of the relay 1 or -1; 1 if the mass sticks; 1 if x is in the gate */
    int mode;
    unsigned long rates, directional;
} Model;

static void initialize(Model *m) {
#if MODEL == STICK_SLIP
    m->v[V] = m->v[B];
    m->mode = 1;
#elif MODEL == RELAY
    m->mode = 1;
#elif MODEL == GATE
    m->v[X] = sin(m->v[TIME]);
#elif MODEL != STAIR
    m->v[STATE] = m->v[START];
#else
    m->has_next = true;
    m->next = m->v[PERIOD];
#endif
}

static Status differentiate(Model *m) {
    double *v = m->v;
#if MODEL == DAHLQUIST
    v[DER_X] = -v[K] * v[X] + v[U];
#elif MODEL == VAN_DER_POL
    v[DER_X0] = v[X1];
    v[DER_X1] = v[MU] * (1 - v[X0] * v[X0]) * v[X1] - v[X0];
#elif MODEL == BALL
    v[DER_H] = v[V];
    v[DER_V] = -9.81;
#elif MODEL == STICK_SLIP
    v[DER_X] = v[V];
    /* the mass is slower than the belt while it slips */
    v[DER_V] = m->mode ? 0 : -v[STIFFNESS] * v[X] + v[SLIP];
#elif MODEL == RELAY
    v[DER_X] = 2 * m->mode - v[X];
    v[DER_Y] = -v[K] * (v[Y] - v[X]);
#elif MODEL == GATE
    v[DER_X] = -v[K] * (v[X] - sin(v[TIME])) + cos(v[TIME]);
#elif MODEL == TANK
    if (v[H] < 0) return DISCARD;
    v[DER_H] = -sqrt(v[H]);
#else
    (void)v;
#endif
    return OK;
}

static Status indicate(const Model *m, double *z);

static void handle_event(Model *m) {
    double *v = m->v;
#if MODEL == BALL
    if (v[H] <= 0 && v[V] < 0) {
        v[H] = 0;
        v[V] = -v[E] * v[V];
    }
#elif MODEL == STICK_SLIP
    if (m->mode && v[STIFFNESS] * v[X] >= v[STICK]) {
        m->mode = 0;
    } else if (!m->mode && v[V] >= v[B]) {
        m->mode = 1;
        v[V] = v[B];
    }
#elif MODEL == RELAY
    if (m->mode * v[X] >= v[BAND]) m->mode = -m->mode;
#elif MODEL == GATE
    double z;
    indicate(m, &z);
    if (z <= 0) {
        m->mode = !m->mode;
        v[PASSES] += 1;
    }
#elif MODEL == STAIR
    while (v[TIME] >= m->next) {
        v[COUNTER] += 1;
        m->next = (v[COUNTER] + 1) * v[PERIOD];
    }
    m->terminate = v[COUNTER] >= v[LIMIT];
#elif MODEL == TANK
    m->terminate = v[H] <= 1e-4;
#else
    (void)v;
#endif
}

static Status indicate(const Model *m, double *z) {
#if MODEL == BALL
    z[0] = m->v[H];
#elif MODEL == STICK_SLIP
    /* at the beginning of a slip the mass is as fast as the belt */
    z[0] = m->mode ? m->v[STICK] - m->v[STIFFNESS] * m->v[X] : m->v[X] < m->v[SLIP] / m->v[STIFFNESS] ? m->v[B] - m->v[V] : 1;
#elif MODEL == RELAY
    z[0] = m->v[BAND] - m->mode * m->v[X];
#elif MODEL == GATE
    z[0] = (m->v[W] - fabs(m->v[X] - 0.5)) * (m->mode ? 1 : -1);
#elif MODEL == TANK
    z[0] = m->v[H] - 1e-4;
#else
    (void)m, (void)z;
#endif
    return OK;
}

/* Derivative of a derivative by a state; NAN if there is none. */
static double directional(Model *m, Reference unknown, Reference known) {
    m->directional++;
#if defined WRONG
    return 0;
#elif MODEL == VAN_DER_POL
    const double *v = m->v;
    if (unknown == DER_X0) return known == X1;
    if (unknown == DER_X1) return known == X0 ? -2 * v[MU] * v[X0] * v[X1] - 1 : v[MU] * (1 - v[X0] * v[X0]);
#elif MODEL == RELAY
    if (unknown == DER_X) return known == X ? -1 : 0;
    if (unknown == DER_Y) return known == X ? m->v[K] : -m->v[K];
#endif
    (void)unknown, (void)known;
    return NAN;
}

static Status differentiate_along(Model *m, const Reference unknowns[], size_t n, const Reference knowns[], size_t count, const double seed[], double result[]) {
    for (size_t i = 0; i < n; i++) {
        result[i] = 0;
        for (size_t k = 0; k < count; k++) result[i] += directional(m, unknowns[i], knowns[k]) * seed[k];
        if (isnan(result[i])) return ERROR;
    }
    return OK;
}

static void discard(Model *m) {
    const char *name = getenv("EXCHANGE_COUNTS");
    FILE *file = name && m ? fopen(name, "a") : NULL;
    if (file) {
        fprintf(file, "%lu %lu\n", m->rates, m->directional);
        fclose(file);
    }
    free(m);
}

static Model *make(void) {
    Model *m = calloc(1, sizeof *m);
    if (m) memcpy(m->v, STARTS, sizeof STARTS);
    return m;
}

static Status reset(Model *m) {
    memset(m, 0, sizeof *m);
    memcpy(m->v, STARTS, sizeof STARTS);
    return OK;
}

static Status get(Model *m, const Reference r[], size_t n, double value[]) {
    Status status = differentiate(m);
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= VARIABLES) return ERROR;
        value[i] = m->v[r[i]];
    }
    return status;
}

static Status set(Model *m, const Reference r[], size_t n, const double value[]) {
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= VARIABLES) return ERROR;
        m->v[r[i]] = value[i];
    }
    return OK;
}

#if FMI == 2
#define F(name) API Status fmi2##name
#else
#define F(name) API Status fmi3##name
#endif

F(ExitInitializationMode)(Model *m) { initialize(m); return OK; }
F(EnterEventMode)(Model *m) { (void)m; return OK; }
F(EnterContinuousTimeMode)(Model *m) { (void)m; return OK; }
F(Terminate)(Model *m) { (void)m; return OK; }
F(Reset)(Model *m) { return reset(m); }
F(SetTime)(Model *m, double time) { m->v[TIME] = time; return OK; }
F(SetContinuousStates)(Model *m, const double x[], size_t n) { memcpy(m->v + STATE, x, n * sizeof *x); return OK; }
F(GetContinuousStates)(Model *m, double x[], size_t n) { memcpy(x, m->v + STATE, n * sizeof *x); return OK; }
F(GetEventIndicators)(Model *m, double z[], size_t n) { return n ? indicate(m, z) : OK; }
static Status derivatives(Model *m, double dx[], size_t n) {
    m->rates++;
    Status status = differentiate(m);
    memcpy(dx, m->v + DERIVATIVE, n * sizeof *dx);
    return status;
}
F(GetNominalsOfContinuousStates)(Model *m, double x[], size_t n) {
    (void)m;
    for (size_t i = 0; i < n; i++) x[i] = 1;
    return OK;
}

/* Functions that some hosts look for and nobody calls: the FMU does not offer what they are for. */
#define NONE(name) F(name)(void) { return ERROR; }

#if FMI == 2

NONE(GetInteger) NONE(SetInteger) NONE(GetBoolean) NONE(SetBoolean) NONE(GetString) NONE(SetString)
NONE(GetFMUstate) NONE(SetFMUstate) NONE(FreeFMUstate) NONE(SerializedFMUstateSize) NONE(SerializeFMUstate)
NONE(DeSerializeFMUstate)

typedef struct {
    int needed, terminate, nominals, values, defined;
    double next;
} EventInfo;

API const char *fmi2GetTypesPlatform(void) { return "default"; }
API const char *fmi2GetVersion(void) { return "2.0"; }
API Model *fmi2Instantiate(const char *name, int kind, const char *guid, const char *resources, const void *callbacks, int visible, int logging) {
    (void)name, (void)resources, (void)callbacks, (void)visible, (void)logging;
    return kind == 0 && !strcmp(guid, "exchange") ? make() : NULL;
}
API void fmi2FreeInstance(Model *m) { discard(m); }
F(SetDebugLogging)(Model *m, int on, size_t n, const char *const names[]) { (void)m, (void)on, (void)n, (void)names; return OK; }
F(SetupExperiment)(Model *m, int with, double tolerance, double start, int stops, double stop) {
    (void)with, (void)tolerance, (void)stops, (void)stop;
    m->v[TIME] = start;
    return OK;
}
F(EnterInitializationMode)(Model *m) { initialize(m); return OK; }
F(GetReal)(Model *m, const Reference r[], size_t n, double value[]) { return get(m, r, n, value); }
F(SetReal)(Model *m, const Reference r[], size_t n, const double value[]) { return set(m, r, n, value); }
F(GetDerivatives)(Model *m, double dx[], size_t n) { return derivatives(m, dx, n); }
F(GetDirectionalDerivative)(Model *m, const Reference unknowns[], size_t n, const Reference knowns[], size_t count, const double seed[], double result[]) {
    return differentiate_along(m, unknowns, n, knowns, count, seed, result);
}
F(NewDiscreteStates)(Model *m, EventInfo *info) {
    handle_event(m);
    *info = (EventInfo){0, m->terminate, 0, MODEL == BALL || MODEL == STICK_SLIP, m->has_next, m->next};
    return OK;
}
F(CompletedIntegratorStep)(Model *m, int no_set, int *event, int *terminate) {
    (void)m, (void)no_set;
    *event = MODEL == DAHLQUIST;
    *terminate = 0;
    return OK;
}

#else

NONE(GetFloat32) NONE(GetInt8) NONE(GetUInt8) NONE(GetInt16) NONE(GetUInt16) NONE(GetInt32) NONE(GetUInt32) NONE(GetInt64)
NONE(SetFloat32) NONE(SetInt8) NONE(SetUInt8) NONE(SetInt16) NONE(SetUInt16) NONE(SetInt32) NONE(SetUInt32) NONE(SetInt64)
NONE(GetUInt64) NONE(GetBoolean) NONE(GetString) NONE(GetBinary) NONE(GetClock)
NONE(SetUInt64) NONE(SetBoolean) NONE(SetString) NONE(SetBinary) NONE(SetClock)
NONE(GetNumberOfVariableDependencies) NONE(GetVariableDependencies) NONE(GetFMUState) NONE(SetFMUState)
NONE(FreeFMUState) NONE(SerializedFMUStateSize) NONE(SerializeFMUState) NONE(DeserializeFMUState)
NONE(GetAdjointDerivative) NONE(EnterConfigurationMode) NONE(ExitConfigurationMode)
NONE(GetIntervalDecimal) NONE(GetIntervalFraction) NONE(GetShiftDecimal) NONE(GetShiftFraction) NONE(SetIntervalDecimal)
NONE(SetIntervalFraction) NONE(SetShiftDecimal) NONE(SetShiftFraction) NONE(EvaluateDiscreteStates)
NONE(ActivateModelPartition) NONE(EnterStepMode) NONE(DoStep) NONE(GetOutputDerivatives)
API Model *fmi3InstantiateCoSimulation(void) { return NULL; }
API Model *fmi3InstantiateScheduledExecution(void) { return NULL; }

API const char *fmi3GetVersion(void) { return "3.0"; }
API Model *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources, bool visible, bool logging, void *environment, void *log) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    return strcmp(token, "exchange") ? NULL : make();
}
API void fmi3FreeInstance(Model *m) { discard(m); }
F(SetDebugLogging)(Model *m, bool on, size_t n, const char *const names[]) { (void)m, (void)on, (void)n, (void)names; return OK; }
F(EnterInitializationMode)(Model *m, bool with, double tolerance, double start, bool stops, double stop) {
    (void)with, (void)tolerance, (void)stops, (void)stop;
    m->v[TIME] = start;
    initialize(m);
    return OK;
}
F(GetFloat64)(Model *m, const Reference r[], size_t n, double value[], size_t count) { return n == count ? get(m, r, n, value) : ERROR; }
F(SetFloat64)(Model *m, const Reference r[], size_t n, const double value[], size_t count) { return n == count ? set(m, r, n, value) : ERROR; }
F(GetNumberOfContinuousStates)(Model *m, size_t *n) { (void)m; *n = STATES; return OK; }
F(GetNumberOfEventIndicators)(Model *m, size_t *n) { (void)m; *n = INDICATORS; return OK; }
F(GetContinuousStateDerivatives)(Model *m, double dx[], size_t n) { return derivatives(m, dx, n); }
F(GetDirectionalDerivative)(Model *m, const Reference unknowns[], size_t n, const Reference knowns[], size_t count, const double seed[], size_t seeds, double result[], size_t results) {
    return seeds == count && results == n ? differentiate_along(m, unknowns, n, knowns, count, seed, result) : ERROR;
}
F(UpdateDiscreteStates)(Model *m, bool *needed, bool *terminate, bool *nominals, bool *values, bool *defined, double *next) {
    handle_event(m);
    *needed = *nominals = false;
    *values = MODEL == BALL || MODEL == STICK_SLIP;
    *terminate = m->terminate;
    *defined = m->has_next;
    *next = m->next;
    return OK;
}
F(CompletedIntegratorStep)(Model *m, bool no_set, bool *event, bool *terminate) {
    (void)m, (void)no_set;
    *event = MODEL == DAHLQUIST;
    *terminate = false;
    return OK;
}

#endif

/*
 * Van der Pol's oscillator, x0' = x1, x1' = mu (1 - x0^2) x1 - x0, as an FMI 2.0 co-simulation FMU.
 *
 * Integrated by the classical Runge-Kutta method in equal steps of at most 1 ms. Value references are those of
 * modelDescription.xml. Build it with ../build.py.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define API __attribute__((visibility("default")))
#define TOKEN "{0d2e5ab4-0f2c-4c4c-9a83-5b0f3d0b6f11}"
#define LONGEST_STEP 1e-3

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING } Status;
/* mu and the initial values are parameters, the state and its derivative outputs */
enum { MU, X0_START, X1_START, X0, X1, DER_X1, VALUES };

static double acceleration(double mu, double x0, double x1) { return mu * (1 - x0 * x0) * x1 - x0; }

static void integrate(double *v, double duration) {
    const int steps = (int)ceil(duration / LONGEST_STEP - 1e-9);
    const double h = duration / steps, mu = v[MU];
    double x = v[X0], y = v[X1];
    for (int step = 0; step < steps; step++) {
        const double x1 = y, y1 = acceleration(mu, x, y);
        const double x2 = y + h / 2 * y1, y2 = acceleration(mu, x + h / 2 * x1, x2);
        const double x3 = y + h / 2 * y2, y3 = acceleration(mu, x + h / 2 * x2, x3);
        const double x4 = y + h * y3, y4 = acceleration(mu, x + h * x3, x4);
        x += h / 6 * (x1 + 2 * x2 + 2 * x3 + x4);
        y += h / 6 * (y1 + 2 * y2 + 2 * y3 + y4);
    }
    v[X0] = x;
    v[X1] = y;
}

API const char *fmi2GetTypesPlatform(void) { return "default"; }
API const char *fmi2GetVersion(void) { return "2.0"; }

API Status fmi2Reset(void *instance) {
    double *v = instance;
    v[MU] = 1.0;
    v[X0_START] = 2.0;
    v[X1_START] = 0.0;
    return OK;
}

API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const void *callbacks,
                          int visible, int logging) {
    (void)name, (void)type, (void)resources, (void)callbacks, (void)visible, (void)logging;
    if (!guid || strcmp(guid, TOKEN) != 0) return NULL;
    double *v = calloc(VALUES, sizeof *v);
    if (v) fmi2Reset(v);
    return v;
}

API void fmi2FreeInstance(void *instance) { free(instance); }

API Status fmi2SetupExperiment(void *instance, int has_tolerance, double tolerance, double start, int has_stop, double stop) {
    (void)has_tolerance, (void)tolerance, (void)start, (void)has_stop, (void)stop;
    return instance ? OK : ERROR;
}

API Status fmi2EnterInitializationMode(void *instance) {
    double *v = instance;
    v[X0] = v[X0_START];
    v[X1] = v[X1_START];
    return OK;
}

API Status fmi2ExitInitializationMode(void *instance) { return instance ? OK : ERROR; }
API Status fmi2Terminate(void *instance) { return instance ? OK : ERROR; }

API Status fmi2GetReal(void *instance, const unsigned references[], size_t n, double values[]) {
    const double *v = instance;
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= VALUES) return ERROR;
        values[i] = references[i] == DER_X1 ? acceleration(v[MU], v[X0], v[X1]) : v[references[i]];
    }
    return OK;
}

API Status fmi2SetReal(void *instance, const unsigned references[], size_t n, const double values[]) {
    for (size_t i = 0; i < n; i++) {
        if (references[i] > X1_START) return ERROR;
        ((double *)instance)[references[i]] = values[i];
    }
    return OK;
}

API Status fmi2DoStep(void *instance, double time, double step, int no_state_prior) {
    (void)time, (void)no_state_prior;
    if (!(step > 0)) return ERROR;
    integrate(instance, step);
    return OK;
}

API Status fmi2SetDebugLogging(void *instance, int on, size_t n, const char *const names[]) {
    (void)on, (void)n, (void)names;
    return instance ? OK : ERROR;
}

/* Functions that hosts load, for features that modelDescription.xml does not offer. */
#define NOT_OFFERED(function) API Status function(void *instance) { (void)instance; return ERROR; }
NOT_OFFERED(fmi2GetInteger) NOT_OFFERED(fmi2GetBoolean) NOT_OFFERED(fmi2GetString)
NOT_OFFERED(fmi2SetInteger) NOT_OFFERED(fmi2SetBoolean) NOT_OFFERED(fmi2SetString)
NOT_OFFERED(fmi2GetFMUstate) NOT_OFFERED(fmi2SetFMUstate) NOT_OFFERED(fmi2FreeFMUstate)
NOT_OFFERED(fmi2SerializedFMUstateSize) NOT_OFFERED(fmi2SerializeFMUstate) NOT_OFFERED(fmi2DeSerializeFMUstate)
NOT_OFFERED(fmi2GetDirectionalDerivative) NOT_OFFERED(fmi2SetRealInputDerivatives) NOT_OFFERED(fmi2GetRealOutputDerivatives)
NOT_OFFERED(fmi2CancelStep) NOT_OFFERED(fmi2GetStatus) NOT_OFFERED(fmi2GetRealStatus)
NOT_OFFERED(fmi2GetIntegerStatus) NOT_OFFERED(fmi2GetBooleanStatus) NOT_OFFERED(fmi2GetStringStatus)

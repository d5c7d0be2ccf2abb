/*
 * An FMI 2.0 co-simulation FMU that goes wrong for some parameter values: y = k1 cos(2 t) + k2 and z = t k1.
 *
 * At 0.5 s, depending on k1, it
 *
 *     [0.1, 0.15)    ends its process by SIGSEGV,
 *     [0.3, 0.35)    ends its process by abort(),
 *     [0.5, 0.55)    hangs,
 *     [0.7, 0.75)    returns fmi2Error,
 *     [0.8, 0.85)    computes NaN,
 *     [0.9, 0.92)    aborts once: a file in the folder FAULTY_MARKS marks the first time,
 *     [0.95, 0.97)   ends the simulation.
 *
 * It prints unrequested text, and a run lasts at least SLOW milliseconds. For any k1, FAULTY makes a function go wrong, for
 * instance FAULTY=fmi2Reset:exit: by exit(0), SIGSEGV (crash), an infinite loop (hang), or an orphaned process (orphan).
 * With SHARED, instances share a count: z is larger by 1e-3 for each earlier instance of the process.
 */
#define _POSIX_C_SOURCE 199309L
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define API __attribute__((visibility("default")))
typedef enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING } Status;
typedef struct {
    void (*logger)(void *, const char *, Status, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, Status);
    void *environment;
} Callbacks;
/* value references: k1, k2, y, z */
typedef struct {
    const Callbacks *callbacks;
    double k1, k2, time;
    int ended;
} Model;

static int *volatile nowhere;
static double shared;

static void fault(const char *function) {
    const char *wanted = getenv("FAULTY");
    const size_t length = strlen(function);
    if (!wanted || strncmp(wanted, function, length) || wanted[length] != ':') return;
    switch (wanted[length + 1]) {
    case 'e': exit(0);
    case 'c': *nowhere = 1; break;
    case 'h': for (;;) sleep(1);
    case 'o':
        if (fork() == 0) {
            sleep(5);
            _exit(0);
        }
        _exit(3);
    }
}

static int within(double value, double from, double to) { return value >= from && value < to; }

static void go_wrong(const Model *model) {
    if (within(model->k1, 0.1, 0.15)) *nowhere = 1;
    if (within(model->k1, 0.3, 0.35)) {
        fprintf(stderr, "faulty: assertion failed\n");
        abort();
    }
    if (within(model->k1, 0.5, 0.55)) {
        for (;;) sleep(1);
    }
    if (within(model->k1, 0.9, 0.92) && getenv("FAULTY_MARKS")) {
        char name[4096];
        snprintf(name, sizeof name, "%s/%.17g", getenv("FAULTY_MARKS"), model->k1);
        if (open(name, O_CREAT | O_EXCL, 0600) != -1) abort();
    }
}

API const char *fmi2GetTypesPlatform(void) { return "default"; }
API const char *fmi2GetVersion(void) { return "2.0"; }

API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const Callbacks *callbacks,
                          int visible, int logging) {
    (void)name, (void)type, (void)guid, (void)resources, (void)visible, (void)logging;
    fault("fmi2Instantiate");
    Model *model = calloc(1, sizeof *model);
    if (!model) return NULL;
    model->callbacks = callbacks;
    model->k1 = 0.6;
    model->k2 = 0.5;
    if (getenv("SHARED")) shared += 1e-3;
    printf("{\"Done\": 3}\n\033[31mhello from the FMU\n");
    fflush(stdout);
    return model;
}

API void fmi2FreeInstance(void *model) {
    fault("fmi2FreeInstance");
    free(model);
}
API Status fmi2SetDebugLogging(void *m, int on, size_t n, const char *const *names) {
    (void)m, (void)on, (void)n, (void)names;
    return OK;
}
API Status fmi2SetupExperiment(void *m, int has, double tolerance, double start, int has_stop, double stop) {
    (void)has, (void)tolerance, (void)has_stop, (void)stop;
    ((Model *)m)->time = start;
    return OK;
}
API Status fmi2EnterInitializationMode(void *m) { return m ? OK : ERROR; }
API Status fmi2ExitInitializationMode(void *m) { return m ? OK : ERROR; }
API Status fmi2Terminate(void *m) { return m ? OK : ERROR; }
API Status fmi2Reset(void *m) {
    fault("fmi2Reset");
    return m ? OK : ERROR;
}

API Status fmi2GetReal(void *m, const unsigned *references, size_t n, double *values) {
    const Model *model = m;
    for (size_t i = 0; i < n; i++) {
        const double all[] = {model->k1, model->k2, model->k1 * cos(2 * model->time) + model->k2,
                              model->time * model->k1 + shared};
        values[i] = all[references[i]];
        if (model->time >= 0.5 && within(model->k1, 0.8, 0.85)) values[i] = NAN;
    }
    return OK;
}

API Status fmi2SetReal(void *m, const unsigned *references, size_t n, const double *values) {
    Model *model = m;
    for (size_t i = 0; i < n; i++) *(references[i] == 0 ? &model->k1 : &model->k2) = values[i];
    return OK;
}

API Status fmi2DoStep(void *m, double time, double step, int no_state_prior) {
    (void)no_state_prior;
    Model *model = m;
    if (getenv("SLOW")) {
        const double seconds = atof(getenv("SLOW")) / 1000.0 * step;
        const struct timespec pause = {(time_t)seconds, (long)(fmod(seconds, 1.0) * 1e9)};
        nanosleep(&pause, NULL);
    }
    if (time + step >= 0.5) {
        fault("fmi2DoStep");
        go_wrong(model);
        if (within(model->k1, 0.7, 0.75)) {
            model->callbacks->logger(model->callbacks->environment, "faulty", ERROR, "logStatusError", "no solution for %g",
                                     0.5);
            return ERROR;
        }
        if (within(model->k1, 0.95, 0.97)) {
            model->ended = 1;
            return DISCARD;
        }
    }
    model->time = time + step;
    return OK;
}

API Status fmi2GetBooleanStatus(void *m, int kind, int *value) {
    (void)kind;
    *value = ((Model *)m)->ended;
    return OK;
}
API Status fmi2GetRealStatus(void *m, int kind, double *value) {
    (void)kind;
    *value = ((Model *)m)->time;
    return OK;
}

/* required functions that are never called */
#define UNUSED(name) API Status name(void *m) { return m ? ERROR : FATAL; }
UNUSED(fmi2GetInteger) UNUSED(fmi2GetBoolean) UNUSED(fmi2GetString) UNUSED(fmi2SetInteger) UNUSED(fmi2SetBoolean)
UNUSED(fmi2SetString) UNUSED(fmi2GetFMUstate) UNUSED(fmi2SetFMUstate) UNUSED(fmi2FreeFMUstate)
UNUSED(fmi2SerializedFMUstateSize) UNUSED(fmi2SerializeFMUstate) UNUSED(fmi2DeSerializeFMUstate)
UNUSED(fmi2GetDirectionalDerivative) UNUSED(fmi2SetRealInputDerivatives) UNUSED(fmi2GetRealOutputDerivatives)
UNUSED(fmi2CancelStep) UNUSED(fmi2GetStatus) UNUSED(fmi2GetIntegerStatus) UNUSED(fmi2GetStringStatus)

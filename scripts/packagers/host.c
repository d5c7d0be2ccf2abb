/* Steps an FMI 2.0 co-simulation library in this process, and times every step.
 *
 * host LIBRARY TOKEN RESOURCES STEPS FIRST_INPUT INPUTS FIRST_OUTPUT OUTPUTS
 *
 * A step is fmi2SetReal of the inputs, fmi2DoStep and fmi2GetReal of the outputs. The inputs are sines of the step's number. Prints the
 * milliseconds to instantiate and initialize, the time in nanoseconds within which half of the steps and 99.9 % of them are done, what reading
 * the clock takes, and the last outputs.
 */
#define _POSIX_C_SOURCE 200809L
#include <dlfcn.h>
#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

typedef void *Component;
typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate_memory)(size_t, size_t);
    void (*free_memory)(void *);
    void (*step_finished)(void *, int);
    void *environment;
} Callbacks;

static Component (*instantiate)(const char *, int, const char *, const char *, const Callbacks *, int, int);
static int (*setup_experiment)(Component, int, double, double, int, double);
static int (*enter_initialization)(Component), (*exit_initialization)(Component), (*terminate)(Component);
static int (*set_real)(Component, const unsigned *, size_t, const double *);
static int (*get_real)(Component, const unsigned *, size_t, double *);
static int (*do_step)(Component, double, double, int);
static void (*free_instance)(Component);

static void logger(void *environment, const char *instance, int status, const char *category, const char *format, ...)
{
    va_list arguments;
    (void)environment;
    if (status < 2) return;
    fprintf(stderr, "%s: status %d, %s: ", instance, status, category);
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
}

static void require(int fine, const char *what)
{
    if (!fine) {
        fprintf(stderr, "host: %s\n", what);
        exit(1);
    }
}

static void bind(void *library, const char *name, void *function)
{
    void *symbol = dlsym(library, name);
    require(symbol != NULL, name);
    *(void **)function = symbol;
}

static double nanoseconds(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return 1e9 * (double)time.tv_sec + (double)time.tv_nsec;
}

static int by_size(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

int main(int count, char **arguments)
{
    require(count == 9, "LIBRARY TOKEN RESOURCES STEPS FIRST_INPUT INPUTS FIRST_OUTPUT OUTPUTS");
    void *library = dlopen(arguments[1], RTLD_NOW | RTLD_LOCAL);
    if (library == NULL) require(0, dlerror());
    bind(library, "fmi2Instantiate", &instantiate);
    bind(library, "fmi2SetupExperiment", &setup_experiment);
    bind(library, "fmi2EnterInitializationMode", &enter_initialization);
    bind(library, "fmi2ExitInitializationMode", &exit_initialization);
    bind(library, "fmi2Terminate", &terminate);
    bind(library, "fmi2SetReal", &set_real);
    bind(library, "fmi2GetReal", &get_real);
    bind(library, "fmi2DoStep", &do_step);
    bind(library, "fmi2FreeInstance", &free_instance);

    long steps = atol(arguments[4]);
    size_t inputs = (size_t)atol(arguments[6]), outputs = (size_t)atol(arguments[8]);
    unsigned references[2][16];
    double x[16] = {0.0}, y[16] = {0.0}, *times = malloc((size_t)steps * sizeof *times);
    require(times != NULL && steps > 0 && inputs <= 16 && outputs <= 16, "too many steps or variables");
    for (unsigned i = 0; i < 16; i++) {
        references[0][i] = (unsigned)atoi(arguments[5]) + i;
        references[1][i] = (unsigned)atoi(arguments[7]) + i;
    }

    Callbacks callbacks = {logger, calloc, free, NULL, NULL};
    double before = nanoseconds();
    Component component = instantiate("host", 1, arguments[2], arguments[3], &callbacks, 0, 0);
    require(component != NULL, "fmi2Instantiate gave no instance");
    require(setup_experiment(component, 0, 0.0, 0.0, 0, 0.0) <= 1, "fmi2SetupExperiment");
    require(enter_initialization(component) <= 1, "fmi2EnterInitializationMode");
    require(exit_initialization(component) <= 1, "fmi2ExitInitializationMode");
    double instantiated = nanoseconds() - before;

    for (long step = 0; step < steps; step++) {
        for (size_t i = 0; i < inputs; i++) x[i] = sin(0.37 * (double)step + (double)i);
        double begin = nanoseconds();
        require(set_real(component, references[0], inputs, x) <= 1, "fmi2SetReal");
        require(do_step(component, 0.001 * (double)step, 0.001, 1) <= 1, "fmi2DoStep");
        require(get_real(component, references[1], outputs, y) <= 1, "fmi2GetReal");
        times[step] = nanoseconds() - begin;
    }
    double clock = nanoseconds();
    for (int i = 0; i < 1000; i++) nanoseconds();
    clock = (nanoseconds() - clock) / 1000.0;

    qsort(times, (size_t)steps, sizeof *times, by_size);
    printf("%.3f %.0f %.0f %.1f", 1e-6 * instantiated, times[steps / 2], times[steps - 1 - steps / 1000], clock);
    for (size_t i = 0; i < outputs; i++) printf(" %.17g", y[i]);
    printf("\n");
    fflush(stdout);
    terminate(component);
    free_instance(component);
    free(times);
    return 0;
}

/* Nanoseconds per step of an FMI 2.0 co-simulation library, called in this process.
 *
 * step LIBRARY TOKEN RESOURCES FIRST_PARAMETER FIRST_OUTPUT REPETITIONS STEPS
 *
 * Sets three parameters, whose value references begin with FIRST_PARAMETER, then times fmi2DoStep and fmi2GetReal of the
 * three outputs from FIRST_OUTPUT on, for runs of STEPS steps that end at 2 s.
 * Prints processor time and wall time per step of each repetition, the last outputs, and the milliseconds to instantiate.
 */
#define _POSIX_C_SOURCE 200809L
#include <dlfcn.h>
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
static int (*enter_initialization)(Component), (*exit_initialization)(Component), (*reset)(Component), (*terminate)(Component);
static int (*set_real)(Component, const unsigned *, size_t, const double *);
static int (*get_real)(Component, const unsigned *, size_t, double *);
static int (*do_step)(Component, double, double, int);
static void (*free_instance)(Component);

static void logger(void *environment, const char *instance, int status, const char *category, const char *format, ...)
{
    va_list arguments;
    (void)environment;
    fprintf(stderr, "%s: status %d, %s: ", instance, status, category);
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
}

static void require(int fine, const char *what)
{
    if (!fine) {
        fprintf(stderr, "step: %s\n", what);
        exit(1);
    }
}

static void bind(void *library, const char *name, void *function)
{
    void *symbol = dlsym(library, name);
    require(symbol != NULL, name);
    *(void **)function = symbol;
}

static double seconds(clockid_t clock)
{
    struct timespec time;
    clock_gettime(clock, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static void start(Component component, unsigned first)
{
    const unsigned references[] = {first, first + 1, first + 2};
    static const double parameters[] = {0.12, 0.05, 2.5};
    require(setup_experiment(component, 0, 0.0, 0.0, 0, 0.0) <= 1, "fmi2SetupExperiment");
    require(set_real(component, references, 3, parameters) <= 1, "fmi2SetReal");
    require(enter_initialization(component) <= 1, "fmi2EnterInitializationMode");
    require(exit_initialization(component) <= 1, "fmi2ExitInitializationMode");
}

int main(int count, char **arguments)
{
    require(count == 8, "LIBRARY TOKEN RESOURCES FIRST_PARAMETER FIRST_OUTPUT REPETITIONS STEPS");
    void *library = dlopen(arguments[1], RTLD_NOW | RTLD_LOCAL);
    if (library == NULL) require(0, dlerror());
    bind(library, "fmi2Instantiate", &instantiate);
    bind(library, "fmi2SetupExperiment", &setup_experiment);
    bind(library, "fmi2EnterInitializationMode", &enter_initialization);
    bind(library, "fmi2ExitInitializationMode", &exit_initialization);
    bind(library, "fmi2Reset", &reset);
    bind(library, "fmi2Terminate", &terminate);
    bind(library, "fmi2SetReal", &set_real);
    bind(library, "fmi2GetReal", &get_real);
    bind(library, "fmi2DoStep", &do_step);
    bind(library, "fmi2FreeInstance", &free_instance);

    unsigned parameter = (unsigned)atoi(arguments[4]), first = (unsigned)atoi(arguments[5]);
    unsigned outputs[] = {first, first + 1, first + 2};
    double values[3] = {0.0, 0.0, 0.0};
    Callbacks callbacks = {logger, calloc, free, NULL, NULL};
    double before = seconds(CLOCK_MONOTONIC);
    Component component = instantiate("latency", 1, arguments[2], arguments[3], &callbacks, 0, 0);
    double after = seconds(CLOCK_MONOTONIC);
    require(component != NULL, "fmi2Instantiate gave no instance");
    start(component, parameter);
    for (int repetition = 0; repetition < atoi(arguments[6]); repetition++) {
        require(reset(component) <= 1, "fmi2Reset");
        start(component, parameter);
        long steps = atol(arguments[7]);
        double size = 2.0 / (double)steps;
        double cpu = seconds(CLOCK_PROCESS_CPUTIME_ID), wall = seconds(CLOCK_MONOTONIC);
        for (long step = 0; step < steps; step++) {
            require(do_step(component, size * (double)step, size, 1) <= 1, "fmi2DoStep");
            require(get_real(component, outputs, 3, values) <= 1, "fmi2GetReal");
        }
        cpu = seconds(CLOCK_PROCESS_CPUTIME_ID) - cpu;
        wall = seconds(CLOCK_MONOTONIC) - wall;
        printf("%.1f %.1f\n", 1e9 * cpu / (double)steps, 1e9 * wall / (double)steps);
    }
    printf("outputs %.17g %.17g %.17g\n", values[0], values[1], values[2]);
    printf("instantiate %.3f\n", 1e3 * (after - before));
    terminate(component);
    free_instance(component);
    return 0;
}

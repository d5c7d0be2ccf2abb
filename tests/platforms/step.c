/* Steps an FMU library of any platform: FMI 2.0 co-simulation of the example surrogate, in portable C99.
 *
 * step LIBRARY FOLDER TOKEN: FOLDER is absolute and has model.safetensors as the example `model_file` writes it.
 * Prints time and outputs, after initialization and after each of 10 steps; the library's messages go to stderr.
 */
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
typedef HMODULE Library;
typedef FARPROC Symbol;
static Library open_library(const char *path) { return LoadLibraryA(path); }
static void close_library(Library library) { FreeLibrary(library); }
static Symbol symbol_of(Library library, const char *name) { return GetProcAddress(library, name); }
#else
#include <dlfcn.h>
typedef void *Library;
typedef void *Symbol;
static Library open_library(const char *path) { return dlopen(path, RTLD_NOW | RTLD_LOCAL); }
static void close_library(Library library) { dlclose(library); }
static Symbol symbol_of(Library library, const char *name) { return dlsym(library, name); }
#endif

typedef void *Component;
typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate_memory)(size_t, size_t);
    void (*free_memory)(void *);
    void (*step_finished)(void *, int);
    void *environment;
} Callbacks;

typedef Component (*Instantiate)(const char *, int, const char *, const char *, const Callbacks *, int, int);
typedef int (*SetupExperiment)(Component, int, double, double, int, double);
typedef int (*Plain)(Component);
typedef int (*SetReal)(Component, const unsigned *, size_t, const double *);
typedef int (*GetReal)(Component, const unsigned *, size_t, double *);
typedef int (*DoStep)(Component, double, double, int);
typedef void (*FreeInstance)(Component);

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

static void fail(const char *what)
{
    fprintf(stderr, "step: %s\n", what);
    exit(1);
}

static void ok(int status, const char *call)
{
    if (status != 0) fail(call);
}

/* ISO C has no conversion of an object pointer to a function pointer; every platform here has the bytes alike. */
static void load(Library library, const char *name, void *function, size_t size)
{
    Symbol symbol = symbol_of(library, name);
    if (symbol == NULL || size != sizeof symbol) fail(name);
    memcpy(function, &symbol, size);
}
#define LOAD(type, name) \
    type name;           \
    load(library, #name, &name, sizeof name)

/* file:///folder, everything but unreserved characters and the separators escaped */
static char *uri_of(const char *folder)
{
    static const char plain[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-._~/:";
    char *uri = malloc(3 * strlen(folder) + sizeof "file:///");
    char *end = uri;
    if (uri == NULL) fail("no memory");
    end += sprintf(end, "file://%s", folder[0] == '/' ? "" : "/");
    for (; *folder != '\0'; folder++) {
        char c = *folder == '\\' ? '/' : *folder;
        end += sprintf(end, strchr(plain, c) != NULL ? "%c" : "%%%02X", (unsigned char)c);
    }
    return uri;
}

int main(int argc, char **argv)
{
    static const unsigned parameters[] = {1, 2}, outputs[] = {4, 5}; /* length, speed; angle, velocity */
    static const double values[] = {0.17, 1.3};
    const double size = 0.1;
    const Callbacks callbacks = {logger, calloc, free, NULL, NULL};
    if (argc != 4) fail("expected LIBRARY FOLDER TOKEN");

    Library library = open_library(argv[1]);
    if (library == NULL) fail("the library does not load");
    LOAD(Instantiate, fmi2Instantiate);
    LOAD(SetupExperiment, fmi2SetupExperiment);
    LOAD(Plain, fmi2EnterInitializationMode);
    LOAD(Plain, fmi2ExitInitializationMode);
    LOAD(SetReal, fmi2SetReal);
    LOAD(GetReal, fmi2GetReal);
    LOAD(DoStep, fmi2DoStep);
    LOAD(Plain, fmi2Terminate);
    LOAD(FreeInstance, fmi2FreeInstance);

    char *uri = uri_of(argv[2]);
    Component component = fmi2Instantiate("example", 1, argv[3], uri, &callbacks, 0, 0);
    free(uri);
    if (component == NULL) fail("fmi2Instantiate");
    ok(fmi2SetReal(component, parameters, 2, values), "fmi2SetReal");
    ok(fmi2SetupExperiment(component, 0, 0.0, 0.0, 0, 0.0), "fmi2SetupExperiment");
    ok(fmi2EnterInitializationMode(component), "fmi2EnterInitializationMode");
    ok(fmi2ExitInitializationMode(component), "fmi2ExitInitializationMode");
    for (int step = 0;; step++) {
        double result[2];
        ok(fmi2GetReal(component, outputs, 2, result), "fmi2GetReal");
        printf("%.17g %.17g %.17g\n", step * size, result[0], result[1]);
        if (step == 10) break;
        ok(fmi2DoStep(component, step * size, size, 1), "fmi2DoStep");
    }
    ok(fmi2Terminate(component), "fmi2Terminate");
    fmi2FreeInstance(component);
    close_library(library);
    return 0;
}

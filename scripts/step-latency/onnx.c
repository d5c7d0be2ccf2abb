/* ONNX Runtime behind the FMI 2.0 functions, through its C interface on one thread: what generated wrappers do.
 *
 * RESOURCES is a folder with `model.onnx` (input `x`, output `y`) and a link `libonnxruntime.so`. The Python package has the
 * library but no header: the table of functions only ever grows at its end, so that positions are part of its interface.
 * Positions checked against the header of release 1.18.
 */
#include "bare.h"
#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>

enum { GET_ERROR_MESSAGE = 2, CREATE_ENVIRONMENT = 3, CREATE_SESSION = 7, RUN = 9, CREATE_SESSION_OPTIONS = 10,
       SET_GRAPH_OPTIMIZATION = 23, SET_THREADS = 24, CREATE_TENSOR = 49, CREATE_CPU_MEMORY_INFO = 69 };
enum { VERSION = 18, WARNING = 2, ALL_OPTIMIZATIONS = 99, FLOAT = 1 };

typedef void *Status;
typedef struct {
    void *const *(*get_api)(uint32_t);
    const char *(*get_version)(void);
} Base;

static void *const *api;
static void *session, *input, *output;
static float x[4], y[3];

static int failed(Status status)
{
    if (status) fprintf(stderr, "onnxruntime: %s\n", ((const char *(*)(Status))api[GET_ERROR_MESSAGE])(status));
    return status != NULL;
}

static Status tensor(void *memory, float *values, int64_t count, void **result)
{
    int64_t shape[] = {1, count};
    Status (*create)(void *, void *, size_t, const int64_t *, size_t, int, void **) = api[CREATE_TENSOR];
    return create(memory, values, (size_t)count * sizeof(float), shape, 2, FLOAT, result);
}

static void *prepare(const char *folder)
{
    char path[4096];
    void *environment, *options, *memory;
    snprintf(path, sizeof path, "%s/libonnxruntime.so", folder);
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library) return fprintf(stderr, "%s\n", dlerror()), NULL;
    const Base *(*base)(void) = (const Base *(*)(void))dlsym(library, "OrtGetApiBase");
    api = base()->get_api(VERSION);
    snprintf(path, sizeof path, "%s/model.onnx", folder);
    if (failed(((Status(*)(int, const char *, void **))api[CREATE_ENVIRONMENT])(WARNING, "latency", &environment))) return NULL;
    if (failed(((Status(*)(void **))api[CREATE_SESSION_OPTIONS])(&options))) return NULL;
    if (failed(((Status(*)(void *, int))api[SET_THREADS])(options, 1))) return NULL;
    if (failed(((Status(*)(void *, int))api[SET_GRAPH_OPTIMIZATION])(options, ALL_OPTIMIZATIONS))) return NULL;
    if (failed(((Status(*)(void *, const char *, void *, void **))api[CREATE_SESSION])(environment, path, options, &session)))
        return NULL;
    if (failed(((Status(*)(int, int, void **))api[CREATE_CPU_MEMORY_INFO])(0, 0, &memory))) return NULL;
    if (failed(tensor(memory, x, 4, &input)) || failed(tensor(memory, y, 3, &output))) return NULL;
    return session;
}

static int evaluate(void *unused, const double *inputs, double *outputs)
{
    static const char *const names[] = {"x", "y"};
    Status (*run)(void *, void *, const char *const *, void *const *, size_t, const char *const *, size_t, void **) = api[RUN];
    (void)unused;
    for (int i = 0; i < 4; i++) x[i] = (float)inputs[i];
    if (failed(run(session, NULL, names, &input, 1, names + 1, 1, &output))) return 3;
    for (int o = 0; o < 3; o++) outputs[o] = (double)y[o];
    return 0;
}

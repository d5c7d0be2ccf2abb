/* The FMI 2.0 functions around a network of 4 inputs and 3 outputs, with nothing that a standard asks for: the floor. */
#include <stddef.h>
#include <stdlib.h>

typedef struct {
    double inputs[4], outputs[3];
} Model;

/* Reads what it needs from a folder; null if it cannot. */
static void *prepare(const char *folder);
static int evaluate(void *prepared, const double *inputs, double *outputs);

static void *prepared;

void *fmi2Instantiate(const char *name, int type, const char *token, const char *resources, const void *callbacks, int visible,
                      int logging)
{
    (void)name, (void)type, (void)token, (void)callbacks, (void)visible, (void)logging;
    prepared = prepare(resources);
    return prepared ? calloc(1, sizeof(Model)) : NULL;
}

int fmi2SetupExperiment(void *model, int tolerant, double tolerance, double start, int stops, double stop)
{
    (void)model, (void)tolerant, (void)tolerance, (void)start, (void)stops, (void)stop;
    return 0;
}

int fmi2EnterInitializationMode(void *model) { return (void)model, 0; }
int fmi2ExitInitializationMode(void *model) { return (void)model, 0; }
int fmi2Reset(void *model) { return (void)model, 0; }
int fmi2Terminate(void *model) { return (void)model, 0; }
void fmi2FreeInstance(void *model) { free(model); }

int fmi2SetReal(void *model, const unsigned *references, size_t count, const double *values)
{
    for (size_t i = 0; i < count; i++) {
        if (references[i] >= 4) return 3;
        ((Model *)model)->inputs[references[i]] = values[i];
    }
    return 0;
}

int fmi2GetReal(void *model, const unsigned *references, size_t count, double *values)
{
    for (size_t i = 0; i < count; i++) {
        if (references[i] < 4 || references[i] >= 7) return 3;
        values[i] = ((Model *)model)->outputs[references[i] - 4];
    }
    return 0;
}

int fmi2DoStep(void *model, double time, double size, int kept)
{
    Model *this = model;
    (void)kept;
    this->inputs[3] = time + size;
    return evaluate(prepared, this->inputs, this->outputs);
}

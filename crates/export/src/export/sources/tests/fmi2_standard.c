/* A host that is written with the names of FMI 2.0 only: it initializes the FMU and makes a step. */
#include "fmi2.h"
#include <stdio.h>
#include <stdlib.h>

static void log_message(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                        fmi2String category, fmi2String message, ...)
{
    (void)environment;
    if (status != fmi2OK && status != fmi2Pending) {
        printf("%s, %s: %s\n", instance, category, message);
    }
}

static void finished(fmi2ComponentEnvironment environment, fmi2Status status)
{
    (void)environment;
    (void)status;
}

static void require(fmi2Status status)
{
    switch (status) {
    case fmi2OK:
    case fmi2Warning:
        return;
    case fmi2Discard:
    case fmi2Error:
    case fmi2Fatal:
    case fmi2Pending:
        exit(1);
    }
}

int main(void)
{
    fmi2CallbackAllocateMemory allocate = calloc;
    fmi2CallbackFreeMemory release = free;
    fmi2StepFinished step_finished = finished;
    const fmi2CallbackFunctions callbacks = {log_message, allocate, release, step_finished, NULL};
    const fmi2Type kind = fmi2CoSimulation;
    const fmi2String name = "standard", location = "file:///nowhere";
    fmi2Component component = fmi2Instantiate(name, kind, model_token, location, &callbacks, fmi2False, fmi2True);
    if (component == NULL) {
        return 1;
    }
    const fmi2ValueReference inputs[] = {1, 2}, output = 4;
    fmi2Real values[] = {0.15, 2.0}, value = -1.0;
    fmi2Boolean terminated = fmi2True;
    fmi2FMUstate state = NULL;
    fmi2Integer integer = 0;
    fmi2Byte bytes[1] = {0};
    require(fmi2SetupExperiment(component, fmi2False, 0.0, 0.0, fmi2True, 2.0));
    require(fmi2SetReal(component, inputs, 2, values));
    require(fmi2EnterInitializationMode(component));
    require(fmi2ExitInitializationMode(component));
    require(fmi2GetFMUstate(component, &state));
    require(fmi2DoStep(component, 0.0, 0.1, fmi2True));
    require(fmi2GetBooleanStatus(component, fmi2Terminated, &terminated));
    require(fmi2GetReal(component, &output, 1, &value));
    require(fmi2FreeFMUstate(component, &state));
    require(fmi2GetInteger(component, &output, 0, &integer));
    if (fmi2SerializeFMUstate(component, state, bytes, sizeof bytes) != fmi2Error) {
        return 1;
    }
    fmi2FreeInstance(component);
    printf("%s %d %g\n", fmi2TypesPlatform, terminated, value);
    return terminated != fmi2False || value == -1.0;
}

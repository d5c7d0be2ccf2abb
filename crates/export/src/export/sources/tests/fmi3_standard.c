/* A host that is written with the names of FMI 3.0 only: it initializes the FMU and makes a step. */
#include "fmi3.h"
#include <stdio.h>
#include <stdlib.h>

static void log_message(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message)
{
    (void)environment;
    if (status != fmi3OK) {
        printf("%s: %s\n", category, message);
    }
}

static void require(fmi3Status status)
{
    if (status == fmi3Discard || status == fmi3Error || status == fmi3Fatal) {
        exit(1);
    }
}

int main(void)
{
    const fmi3LogMessageCallback logger = log_message;
    const fmi3ClockUpdateCallback clock_update = NULL;
    const fmi3LockPreemptionCallback lock = NULL;
    const fmi3UnlockPreemptionCallback unlock = NULL;
    const fmi3String name = "standard", path = "/nowhere/";
    if (fmi3InstantiateScheduledExecution(name, model_token, path, fmi3False, fmi3False, NULL, logger, clock_update, lock, unlock) != NULL) {
        return 1;
    }
    fmi3Instance instance =
        fmi3InstantiateCoSimulation(name, model_token, path, fmi3False, fmi3True, fmi3False, fmi3False, NULL, 0, NULL, logger, NULL);
    if (instance == NULL) {
        return 1;
    }
    const fmi3ValueReference inputs[] = {1, 2}, output = 4;
    fmi3Float64 values[] = {0.15, 2.0}, value = -1.0, last = 0.0;
    fmi3Boolean event = fmi3True, terminate = fmi3True, early = fmi3True;
    fmi3FMUState state = NULL;
    size_t count = 0;
    require(fmi3SetFloat64(instance, inputs, 2, values, 2));
    require(fmi3EnterInitializationMode(instance, fmi3False, 0.0, 0.0, fmi3True, 2.0));
    require(fmi3ExitInitializationMode(instance));
    require(fmi3GetFMUState(instance, &state));
    require(fmi3DoStep(instance, 0.0, 0.1, fmi3True, &event, &terminate, &early, &last));
    require(fmi3GetFloat64(instance, &output, 1, &value, 1));
    require(fmi3FreeFMUState(instance, &state));
    require(fmi3GetNumberOfVariableDependencies(instance, output, &count));
    size_t elements[2][8];
    fmi3ValueReference independents[8];
    fmi3DependencyKind kinds[8];
    require(fmi3GetVariableDependencies(instance, output, elements[0], independents, elements[1], kinds, count));
    fmi3IntervalQualifier qualifier = fmi3IntervalNotYetKnown;
    fmi3Float64 interval;
    const fmi3Status refused = fmi3GetIntervalDecimal(instance, &output, 1, &interval, &qualifier);
    const fmi3Clock clock = fmi3ClockInactive;
    fmi3FreeInstance(instance);
    printf("%d %g\n", (int)kinds[0], value);
    return refused == fmi3OK || clock || terminate || count == 0 || kinds[0] != fmi3Dependent || value == -1.0;
}

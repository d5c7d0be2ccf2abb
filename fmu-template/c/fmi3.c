/*
 * FMI 3.0: co-simulation and model exchange. Each function checks that the state allows the call and that its pointers
 * are not null, and calls the instance. fmi3_absent.c has the functions for features that this FMU lacks.
 */
#include "fmi3.h"
#include "calls_fmi3.h"
#include <stdlib.h>

/* The object that fmi3Instance points to. */
typedef struct {
    Instance instance; /* first, so that a pointer to it is also one to the component */
    fmi3LogMessageCallback logger;
    void *environment;
    fmi3IntermediateUpdateCallback update; /* for models with states, if the host has one */
    bool early_return;                     /* true if the host allows steps to end early */
    Snapshot before;                       /* state at the beginning of a step with updates */
} Component;

static void send_message(const Instance *instance, Status status, const char *category, const char *message)
{
    const Component *component = (const Component *)instance;
    if (component->logger != NULL) {
        component->logger(component->environment, status, category, message);
    }
}

/* ---- Version, instances, logging ---- */

const char *fmi3GetVersion(void)
{
    return "3.0";
}

static Component *new_component(Interface interface, bool event_mode, bool logging, void *environment,
                                fmi3LogMessageCallback logger)
{
    Component *component = calloc(1, sizeof(Component));
    if (component != NULL) {
        component->logger = logger;
        component->environment = environment;
        component->instance.fmi_version = 3;
        component->instance.interface = interface;
        component->instance.event_mode = event_mode;
        component->instance.send = send_message;
        component->instance.log_warnings = logging;
        component->instance.log_everything = logging;
    }
    return component;
}

/* Returns the component if all arguments are valid; otherwise frees it and returns null. */
static Component *checked(Component *component, bool good)
{
    if (good) {
        instance_tell(&component->instance, STATUS_OK, "%s", model_description);
        return component;
    }
    free(component);
    return NULL;
}

void *fmi3InstantiateModelExchange(const char *instanceName, const char *instantiationToken, const char *resourcePath,
                                   bool visible, bool loggingOn, void *instanceEnvironment,
                                   fmi3LogMessageCallback logMessage)
{
    (void)resourcePath; /* everything is compiled in */
    (void)visible;
    Component *component = new_component(MODEL_EXCHANGE, true, loggingOn, instanceEnvironment, logMessage);
    if (component == NULL) {
        return NULL;
    }
    Instance *instance = &component->instance;
    instance_initialize(instance, "fmi3InstantiateModelExchange");
    return checked(component, instance_check_name(instance, instanceName) &&
                                  instance_check_token(instance, instantiationToken, "instantiationToken"));
}

/*
 * Models with states call the host back after each step of their solver. A step of other models is a single evaluation,
 * and they ignore the callback.
 */
void *fmi3InstantiateCoSimulation(const char *instanceName, const char *instantiationToken, const char *resourcePath,
                                  bool visible, bool loggingOn, bool eventModeUsed, bool earlyReturnAllowed,
                                  const uint32_t requiredIntermediateVariables[],
                                  size_t nRequiredIntermediateVariables, void *instanceEnvironment,
                                  fmi3LogMessageCallback logMessage,
                                  fmi3IntermediateUpdateCallback intermediateUpdate)
{
    (void)resourcePath; /* everything is compiled in */
    (void)visible;
    Component *component =
        new_component(CO_SIMULATION, eventModeUsed, loggingOn, instanceEnvironment, logMessage);
    if (component == NULL) {
        return NULL;
    }
    Instance *instance = &component->instance;
    instance_initialize(instance, "fmi3InstantiateCoSimulation");
    bool good = instance_check_name(instance, instanceName) &&
                !instance_lacks(instance, requiredIntermediateVariables, nRequiredIntermediateVariables,
                                "requiredIntermediateVariables") &&
                instance_check_token(instance, instantiationToken, "instantiationToken");
    if (MODEL_HAS_STATES && intermediateUpdate != NULL) {
        component->update = intermediateUpdate;
        component->early_return = earlyReturnAllowed;
        instance->function = "fmi3InstantiateCoSimulation: argument `requiredIntermediateVariables`";
        for (size_t i = 0; good && i < nRequiredIntermediateVariables; i++) {
            good = instance_check_intermediate(instance, requiredIntermediateVariables[i]) == STATUS_OK;
        }
        instance->function = "fmi3InstantiateCoSimulation";
    }
    return checked(component, good);
}

void *fmi3InstantiateScheduledExecution(const char *instanceName, const char *instantiationToken,
                                        const char *resourcePath, bool visible, bool loggingOn,
                                        void *instanceEnvironment, fmi3LogMessageCallback logMessage,
                                        fmi3ClockUpdateCallback clockUpdate, fmi3LockPreemptionCallback lockPreemption,
                                        fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)instanceName;
    (void)instantiationToken;
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    (void)clockUpdate;
    (void)lockPreemption;
    (void)unlockPreemption;
    if (logMessage != NULL) {
        logMessage(instanceEnvironment, (int)STATUS_ERROR, "logStatusError",
                   "fmi3InstantiateScheduledExecution: scheduled execution is not offered");
    }
    return NULL;
}

void fmi3FreeInstance(void *instance)
{
    free(instance);
}

Status fmi3SetDebugLogging(void *instance, bool loggingOn, size_t nCategories, const char *const categories[])
{
    if (!instance_begin(instance, CALL(fmi3SetDebugLogging))) {
        return STATUS_ERROR;
    }
    return instance_switch_logging(instance, loggingOn, nCategories, categories);
}

/* ---- Modes ---- */

Status fmi3EnterInitializationMode(void *instance, bool toleranceDefined, double tolerance, double startTime,
                                   bool stopTimeDefined, double stopTime)
{
    if (!instance_begin(instance, CALL(fmi3EnterInitializationMode))) {
        return STATUS_ERROR;
    }
    const Status status = instance_set_up_experiment(instance, toleranceDefined, tolerance, startTime,
                                                     stopTimeDefined, stopTime);
    if (status == STATUS_ERROR || instance_enter_initialization_mode(instance) != STATUS_OK) {
        return STATUS_ERROR;
    }
    return status;
}

Status fmi3ExitInitializationMode(void *instance)
{
    if (!instance_begin(instance, CALL(fmi3ExitInitializationMode))) {
        return STATUS_ERROR;
    }
    return instance_exit_initialization_mode(instance);
}

Status fmi3EnterEventMode(void *instance)
{
    if (!instance_begin(instance, CALL(fmi3EnterEventMode))) {
        return STATUS_ERROR;
    }
    return instance_enter_event_mode(instance);
}

/* Changes the state, for calls that do nothing else. */
static Status change_state(Instance *instance, const char *function, unsigned allowed, State state)
{
    if (!instance_begin(instance, function, allowed)) {
        return STATUS_ERROR;
    }
    instance->now.state = state;
    return STATUS_OK;
}

Status fmi3EnterContinuousTimeMode(void *instance)
{
    return change_state(instance, CALL(fmi3EnterContinuousTimeMode), STATE_CONTINUOUS_TIME);
}

Status fmi3EnterStepMode(void *instance)
{
    return change_state(instance, CALL(fmi3EnterStepMode), STATE_STEP);
}

Status fmi3Terminate(void *instance)
{
    return change_state(instance, CALL(fmi3Terminate), STATE_TERMINATED);
}

Status fmi3Reset(void *instance)
{
    if (!instance_begin(instance, CALL(fmi3Reset))) {
        return STATUS_ERROR;
    }
    instance_reset(instance);
    return STATUS_OK;
}

Status fmi3EvaluateDiscreteStates(void *instance)
{
    return change_state(instance, CALL(fmi3EvaluateDiscreteStates), STATE_EVENT);
}

/* There are no events. */
Status fmi3UpdateDiscreteStates(void *instance, bool *discreteStatesNeedUpdate, bool *terminateSimulation,
                                bool *nominalsOfContinuousStatesChanged, bool *valuesOfContinuousStatesChanged,
                                bool *nextEventTimeDefined, double *nextEventTime)
{
    if (!instance_begin(instance, CALL(fmi3UpdateDiscreteStates)) ||
        instance_lacks(instance, discreteStatesNeedUpdate, 1, "discreteStatesNeedUpdate") ||
        instance_lacks(instance, terminateSimulation, 1, "terminateSimulation") ||
        instance_lacks(instance, nominalsOfContinuousStatesChanged, 1, "nominalsOfContinuousStatesChanged") ||
        instance_lacks(instance, valuesOfContinuousStatesChanged, 1, "valuesOfContinuousStatesChanged") ||
        instance_lacks(instance, nextEventTimeDefined, 1, "nextEventTimeDefined") ||
        instance_lacks(instance, nextEventTime, 1, "nextEventTime")) {
        return STATUS_ERROR;
    }
    *discreteStatesNeedUpdate = false;
    *terminateSimulation = false;
    *nominalsOfContinuousStatesChanged = false;
    *valuesOfContinuousStatesChanged = false;
    *nextEventTimeDefined = false;
    *nextEventTime = 0.0;
    return STATUS_OK;
}

/* ---- Values: all variables are scalars ---- */

/* Returns true, after a message, if the arguments of a call that gets or sets values are invalid. */
static bool bad_arguments(Instance *instance, const uint32_t references[], size_t reference_count, const void *values,
                          size_t value_count)
{
    return instance_lacks(instance, references, reference_count, "valueReferences") ||
           instance_miscounts(instance, value_count, reference_count, "values") ||
           instance_lacks(instance, values, value_count, "values");
}

Status fmi3GetFloat64(void *instance, const uint32_t valueReferences[], size_t nValueReferences, double values[],
                      size_t nValues)
{
    if (!instance_begin(instance, CALL(fmi3GetFloat64)) ||
        bad_arguments(instance, valueReferences, nValueReferences, values, nValues)) {
        return STATUS_ERROR;
    }
    return instance_get_real(instance, valueReferences, nValueReferences, values);
}

Status fmi3GetInt32(void *instance, const uint32_t valueReferences[], size_t nValueReferences, int32_t values[],
                    size_t nValues)
{
    if (!instance_begin(instance, CALL(fmi3GetInt32)) ||
        bad_arguments(instance, valueReferences, nValueReferences, values, nValues)) {
        return STATUS_ERROR;
    }
    return instance_get_integer(instance, valueReferences, nValueReferences, values);
}

Status fmi3GetBoolean(void *instance, const uint32_t valueReferences[], size_t nValueReferences, bool values[],
                      size_t nValues)
{
    if (!instance_begin(instance, CALL(fmi3GetBoolean)) ||
        bad_arguments(instance, valueReferences, nValueReferences, values, nValues) ||
        instance_check_booleans(instance, valueReferences, nValueReferences) != STATUS_OK) {
        return STATUS_ERROR;
    }
    for (size_t i = 0; i < nValues; i++) {
        values[i] = instance_boolean(instance, valueReferences[i]);
    }
    return STATUS_OK;
}

Status fmi3SetFloat64(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                      const double values[], size_t nValues)
{
    if (!instance_begin(instance, CALL(fmi3SetFloat64)) ||
        bad_arguments(instance, valueReferences, nValueReferences, values, nValues)) {
        return STATUS_ERROR;
    }
    return instance_set_real(instance, valueReferences, nValueReferences, values);
}

Status fmi3SetInt32(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const int32_t values[],
                    size_t nValues)
{
    if (!instance_begin(instance, CALL(fmi3SetInt32)) ||
        bad_arguments(instance, valueReferences, nValueReferences, values, nValues)) {
        return STATUS_ERROR;
    }
    return instance_set_integer(instance, valueReferences, nValueReferences, values);
}

Status fmi3SetBoolean(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const bool values[],
                      size_t nValues)
{
    if (!instance_begin(instance, CALL(fmi3SetBoolean)) ||
        bad_arguments(instance, valueReferences, nValueReferences, values, nValues) ||
        instance_check_set_boolean(instance, valueReferences, nValueReferences) != STATUS_OK) {
        return STATUS_ERROR;
    }
    if (nValues > 0) {
        instance_use_measured(instance, values[nValues - 1]);
    }
    return STATUS_OK;
}

/* ---- Dependencies and derivatives ---- */

Status fmi3GetNumberOfVariableDependencies(void *instance, uint32_t valueReference, size_t *nDependencies)
{
    if (!instance_begin(instance, CALL(fmi3GetNumberOfVariableDependencies)) ||
        instance_lacks(instance, nDependencies, 1, "nDependencies")) {
        return STATUS_ERROR;
    }
    return instance_count_dependencies(instance, valueReference, nDependencies);
}

Status fmi3GetVariableDependencies(void *instance, uint32_t dependent, size_t elementIndicesOfDependent[],
                                   uint32_t independents[], size_t elementIndicesOfIndependents[],
                                   fmi3DependencyKind dependencyKinds[], size_t nDependencies)
{
    size_t count;
    if (!instance_begin(instance, CALL(fmi3GetVariableDependencies)) ||
        instance_count_dependencies(instance, dependent, &count) != STATUS_OK ||
        instance_miscounts(instance, nDependencies, count, "independents") ||
        instance_lacks(instance, elementIndicesOfDependent, count, "elementIndicesOfDependent") ||
        instance_lacks(instance, independents, count, "independents") ||
        instance_lacks(instance, elementIndicesOfIndependents, count, "elementIndicesOfIndependents") ||
        instance_lacks(instance, dependencyKinds, count, "dependencyKinds")) {
        return STATUS_ERROR;
    }
    for (size_t i = 0; i < count; i++) {
        /* zero: all elements of a variable; a scalar has only one */
        elementIndicesOfDependent[i] = 0;
        elementIndicesOfIndependents[i] = 0;
        independents[i] = instance_dependency(i);
        dependencyKinds[i] = fmi3Dependent;
    }
    return STATUS_OK;
}

Status fmi3GetDirectionalDerivative(void *instance, const uint32_t unknowns[], size_t nUnknowns,
                                    const uint32_t knowns[], size_t nKnowns, const double seed[], size_t nSeed,
                                    double sensitivity[], size_t nSensitivity)
{
    if (!instance_begin(instance, CALL(fmi3GetDirectionalDerivative)) ||
        instance_lacks(instance, unknowns, nUnknowns, "unknowns") ||
        instance_lacks(instance, knowns, nKnowns, "knowns") ||
        instance_miscounts(instance, nSeed, nKnowns, "seed") ||
        instance_miscounts(instance, nSensitivity, nUnknowns, "sensitivity") ||
        instance_lacks(instance, seed, nSeed, "seed") ||
        instance_lacks(instance, sensitivity, nSensitivity, "sensitivity")) {
        return STATUS_ERROR;
    }
    return instance_directional_derivative(instance, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity);
}

Status fmi3GetAdjointDerivative(void *instance, const uint32_t unknowns[], size_t nUnknowns, const uint32_t knowns[],
                                size_t nKnowns, const double seed[], size_t nSeed, double sensitivity[],
                                size_t nSensitivity)
{
    if (!instance_begin(instance, CALL(fmi3GetAdjointDerivative)) ||
        instance_lacks(instance, unknowns, nUnknowns, "unknowns") ||
        instance_lacks(instance, knowns, nKnowns, "knowns") ||
        instance_miscounts(instance, nSeed, nUnknowns, "seed") ||
        instance_miscounts(instance, nSensitivity, nKnowns, "sensitivity") ||
        instance_lacks(instance, seed, nSeed, "seed") ||
        instance_lacks(instance, sensitivity, nSensitivity, "sensitivity")) {
        return STATUS_ERROR;
    }
    return instance_adjoint_derivative(instance, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity);
}

Status fmi3GetOutputDerivatives(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                const int32_t orders[], double values[], size_t nValues)
{
    if (!instance_begin(instance, CALL(fmi3GetOutputDerivatives)) ||
        instance_lacks(instance, valueReferences, nValueReferences, "valueReferences") ||
        instance_miscounts(instance, nValues, nValueReferences, "values") ||
        instance_lacks(instance, orders, nValueReferences, "orders") ||
        instance_lacks(instance, values, nValues, "values")) {
        return STATUS_ERROR;
    }
    return instance_output_derivatives(instance, valueReferences, nValueReferences, orders, values);
}

/* ---- FMU state ---- */

/* Returns the state that FMUState points to, a new one if there is none; null after a message if there is no memory. */
static Snapshot *state_at(Instance *instance, void **FMUState)
{
    if (instance_lacks(instance, FMUState, 1, "FMUState")) {
        return NULL;
    }
    if (*FMUState == NULL) {
        *FMUState = calloc(1, sizeof(Snapshot));
    }
    if (*FMUState == NULL) {
        instance_tell(instance, STATUS_ERROR, "no memory for a state");
    }
    return *FMUState;
}

Status fmi3GetFMUState(void *instance, void **FMUState)
{
    if (!instance_begin(instance, CALL(fmi3GetFMUState))) {
        return STATUS_ERROR;
    }
    Snapshot *state = state_at(instance, FMUState);
    if (state == NULL) {
        return STATUS_ERROR;
    }
    instance_save(instance, state);
    return STATUS_OK;
}

Status fmi3SetFMUState(void *instance, void *FMUState)
{
    if (!instance_begin(instance, CALL(fmi3SetFMUState)) || instance_lacks(instance, FMUState, 1, "FMUState")) {
        return STATUS_ERROR;
    }
    return instance_restore(instance, FMUState);
}

Status fmi3FreeFMUState(void *instance, void **FMUState)
{
    if (!instance_begin(instance, CALL(fmi3FreeFMUState))) {
        return STATUS_ERROR;
    }
    if (FMUState != NULL) {
        free(*FMUState);
        *FMUState = NULL;
    }
    return STATUS_OK;
}

Status fmi3SerializedFMUStateSize(void *instance, void *FMUState, size_t *size)
{
    if (!instance_begin(instance, CALL(fmi3SerializedFMUStateSize)) ||
        instance_lacks(instance, FMUState, 1, "FMUState") || instance_lacks(instance, size, 1, "size")) {
        return STATUS_ERROR;
    }
    *size = snapshot_size();
    return STATUS_OK;
}

Status fmi3SerializeFMUState(void *instance, void *FMUState, uint8_t serializedState[], size_t size)
{
    if (!instance_begin(instance, CALL(fmi3SerializeFMUState)) ||
        instance_lacks(instance, FMUState, 1, "FMUState")) {
        return STATUS_ERROR;
    }
    return instance_serialize(instance, FMUState, serializedState, size);
}

Status fmi3DeserializeFMUState(void *instance, const uint8_t serializedState[], size_t size, void **FMUState)
{
    Snapshot state;
    if (!instance_begin(instance, CALL(fmi3DeserializeFMUState)) ||
        instance_lacks(instance, serializedState, size, "serializedState") ||
        instance_deserialize(instance, serializedState, size, &state) != STATUS_OK) {
        return STATUS_ERROR;
    }
    Snapshot *to = state_at(instance, FMUState);
    if (to == NULL) {
        return STATUS_ERROR;
    }
    *to = state;
    return STATUS_OK;
}

/* ---- Model exchange: no events ---- */

Status fmi3CompletedIntegratorStep(void *instance, bool noSetFMUStatePriorToCurrentPoint, bool *enterEventMode,
                                   bool *terminateSimulation)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!instance_begin(instance, CALL(fmi3CompletedIntegratorStep)) ||
        instance_lacks(instance, enterEventMode, 1, "enterEventMode") ||
        instance_lacks(instance, terminateSimulation, 1, "terminateSimulation")) {
        return STATUS_ERROR;
    }
    *enterEventMode = false;
    *terminateSimulation = false;
    return instance_accept_point(instance);
}

Status fmi3SetTime(void *instance, double time)
{
    if (!instance_begin(instance, CALL(fmi3SetTime))) {
        return STATUS_ERROR;
    }
    return instance_set_solver_time(instance, time);
}

/* Returns true, after a message, unless the arguments are one number for each state. */
static bool bad_states(Instance *instance, const double values[], size_t count, const char *argument)
{
    return instance_miscounts(instance, count, STATE_COUNT, argument) ||
           instance_lacks(instance, values, count, argument);
}

Status fmi3SetContinuousStates(void *instance, const double continuousStates[], size_t nContinuousStates)
{
    if (!instance_begin(instance, CALL(fmi3SetContinuousStates)) ||
        bad_states(instance, continuousStates, nContinuousStates, "continuousStates")) {
        return STATUS_ERROR;
    }
    return instance_set_states(instance, continuousStates);
}

Status fmi3GetContinuousStateDerivatives(void *instance, double derivatives[], size_t nContinuousStates)
{
    if (!instance_begin(instance, CALL(fmi3GetContinuousStateDerivatives)) ||
        bad_states(instance, derivatives, nContinuousStates, "derivatives")) {
        return STATUS_ERROR;
    }
    return instance_get_derivatives(instance, derivatives);
}

Status fmi3GetEventIndicators(void *instance, double eventIndicators[], size_t nEventIndicators)
{
    (void)eventIndicators;
    if (!instance_begin(instance, CALL(fmi3GetEventIndicators)) ||
        instance_miscounts(instance, nEventIndicators, 0, "eventIndicators")) {
        return STATUS_ERROR;
    }
    return STATUS_OK;
}

Status fmi3GetContinuousStates(void *instance, double continuousStates[], size_t nContinuousStates)
{
    if (!instance_begin(instance, CALL(fmi3GetContinuousStates)) ||
        bad_states(instance, continuousStates, nContinuousStates, "continuousStates")) {
        return STATUS_ERROR;
    }
    instance_get_states(instance, continuousStates);
    return STATUS_OK;
}

Status fmi3GetNominalsOfContinuousStates(void *instance, double nominals[], size_t nContinuousStates)
{
    if (!instance_begin(instance, CALL(fmi3GetNominalsOfContinuousStates)) ||
        bad_states(instance, nominals, nContinuousStates, "nominals")) {
        return STATUS_ERROR;
    }
    instance_get_nominals(nominals);
    return STATUS_OK;
}

static Status get_count(Instance *instance, const char *function, unsigned allowed, size_t value, size_t *count,
                        const char *argument)
{
    if (!instance_begin(instance, function, allowed) || instance_lacks(instance, count, 1, argument)) {
        return STATUS_ERROR;
    }
    *count = value;
    return STATUS_OK;
}

Status fmi3GetNumberOfEventIndicators(void *instance, size_t *nEventIndicators)
{
    return get_count(instance, CALL(fmi3GetNumberOfEventIndicators), 0, nEventIndicators, "nEventIndicators");
}

Status fmi3GetNumberOfContinuousStates(void *instance, size_t *nContinuousStates)
{
    return get_count(instance, CALL(fmi3GetNumberOfContinuousStates), STATE_COUNT, nContinuousStates,
                     "nContinuousStates");
}

/* ---- Co-simulation ---- */

static bool has_inputs(void)
{
    for (size_t i = 0; i < INPUT_COUNT; i++) {
        if (model_columns[i].role == ROLE_INPUT) {
            return true;
        }
    }
    return false;
}

/* Calls the host back at `time`. Returns the time at which the step is to end. */
static double update(Component *component, double time, double end, bool can_return)
{
    bool requested = false;
    double return_time = time;
    component->instance.now.state = STATE_UPDATE;
    component->update(component->environment, time, has_inputs(), true, true, can_return, &requested, &return_time);
    if (component->instance.now.state == STATE_UPDATE) {
        component->instance.now.state = STATE_STEP; /* otherwise, an input that domain_policy 2 forbids ended the run */
    }
    if (!can_return || !requested) {
        return end;
    }
    /* NaN, or a time that is not later, means now */
    if (!(return_time > time)) {
        return time;
    }
    return return_time < end ? return_time : end;
}

/* Makes a communication step that calls the host back after each step of the solver. */
static Status step_with_updates(Component *component, double from, double size, bool *early)
{
    Instance *instance = &component->instance;
    const double steps = instance_updates(size);
    const double whole = from + size;
    double end = whole;
    double time = from;
    double step = 0.0;
    const Status checked = instance_check_step(instance, from, size);
    if (checked != STATUS_OK) {
        return checked;
    }
    component->before = instance->now;
    do {
        step += 1.0;
        const double planned = from + size * (step / steps);
        /* the last one ends exactly at the end */
        const double next = step < steps && planned < end ? planned : end;
        if (!instance_begin(instance, CALL(fmi3DoStep))) {
            return STATUS_ERROR;
        }
        instance->since = time - from;
        const Status status = instance_do_step(instance, time, next - time);
        instance->since = 0.0;
        if (status == STATUS_DISCARD) {
            instance_restore(instance, &component->before);
        }
        if (status != STATUS_OK) {
            return status;
        }
        time = next;
        end = update(component, time, end, component->early_return && time < whole);
    } while (time < end);
    *early = time < whole;
    return instance_begin(instance, CALL(fmi3DoStep)) ? STATUS_OK : STATUS_ERROR;
}

Status fmi3DoStep(void *instance, double currentCommunicationPoint, double communicationStepSize,
                  bool noSetFMUStatePriorToCurrentPoint, bool *eventHandlingNeeded, bool *terminateSimulation,
                  bool *earlyReturn, double *lastSuccessfulTime)
{
    Component *component = instance;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!instance_begin(instance, CALL(fmi3DoStep)) ||
        instance_lacks(instance, eventHandlingNeeded, 1, "eventHandlingNeeded") ||
        instance_lacks(instance, terminateSimulation, 1, "terminateSimulation") ||
        instance_lacks(instance, earlyReturn, 1, "earlyReturn") ||
        instance_lacks(instance, lastSuccessfulTime, 1, "lastSuccessfulTime")) {
        return STATUS_ERROR;
    }
    *eventHandlingNeeded = false;
    *terminateSimulation = false;
    *earlyReturn = false;
    const Status status =
        component->update != NULL
            ? step_with_updates(component, currentCommunicationPoint, communicationStepSize, earlyReturn)
            : instance_do_step(instance, currentCommunicationPoint, communicationStepSize);
    *lastSuccessfulTime = component->instance.now.time;
    return status;
}

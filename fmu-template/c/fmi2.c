/*
 * FMI 2.0: co-simulation and model exchange. Each function checks that the state allows the call and that its pointers
 * are not null, and calls the instance.
 */
#include "fmi2.h"
#include "calls_fmi2.h"
#include <stdlib.h>
#include <string.h>

/* The object that fmi2Component points to. */
typedef struct {
    Instance instance; /* first, so that a pointer to it is also one to the component */
    fmi2CallbackLogger logger;
    void *environment;
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *memory);
    char name[];
} Component;

static void send_message(const Instance *instance, Status status, const char *category, const char *message)
{
    const Component *component = (const Component *)instance;
    component->logger(component->environment, component->name, status, category, "%s", message);
}

/* ---- Version, instances, logging ---- */

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return "2.0";
}

/* Allocates memory by the host's functions, if it provides them. */
static Component *new_component(const char *name, const fmi2CallbackFunctions *functions)
{
    const bool offered = functions->allocateMemory != NULL && functions->freeMemory != NULL;
    void *(*const allocate)(size_t, size_t) = offered ? functions->allocateMemory : calloc;
    const size_t length = name == NULL ? 0 : strlen(name);
    Component *component = allocate(1, sizeof(Component) + length + 1);
    if (component != NULL) {
        /* not every host returns zeros */
        memset(component, 0, sizeof *component);
        component->allocate = allocate;
        component->release = offered ? functions->freeMemory : free;
        component->logger = functions->logger;
        component->environment = functions->componentEnvironment;
        memcpy(component->name, length == 0 ? "" : name, length + 1);
    }
    return component;
}

static bool check_type(Instance *instance, fmi2Type type)
{
    if (type == fmi2ModelExchange || type == fmi2CoSimulation) {
        return true;
    }
    instance_tell(instance, STATUS_ERROR, "FMU type is %d, expected 0 (model exchange) or 1 (co-simulation)",
                  (int)type);
    return false;
}

void *fmi2Instantiate(const char *instanceName, fmi2Type fmuType, const char *fmuGUID, const char *fmuResourceLocation,
                      const fmi2CallbackFunctions *functions, int visible, int loggingOn)
{
    (void)fmuResourceLocation; /* everything is compiled in */
    (void)visible;
    if (functions == NULL || functions->logger == NULL) {
        return NULL;
    }
    Component *component = new_component(instanceName, functions);
    if (component == NULL) {
        return NULL;
    }
    Instance *instance = &component->instance;
    instance->fmi_version = 2;
    instance->interface = fmuType == fmi2ModelExchange ? MODEL_EXCHANGE : CO_SIMULATION;
    instance->event_mode = false;
    instance->send = send_message;
    /* loggingOn controls debug messages only: no status reports a warning. fmi2SetDebugLogging can turn warnings off. */
    instance->log_warnings = true;
    instance->log_everything = loggingOn != 0;
    instance_initialize(instance, "fmi2Instantiate");
    if (!instance_check_name(instance, instanceName) || !check_type(instance, fmuType) ||
        !instance_check_token(instance, fmuGUID, "fmuGUID")) {
        component->release(component);
        return NULL;
    }
    instance_tell(instance, STATUS_OK, "%s", model_description);
    return component;
}

void fmi2FreeInstance(void *c)
{
    Component *component = c;
    if (component != NULL) {
        component->release(component);
    }
}

Status fmi2SetDebugLogging(void *c, int loggingOn, size_t nCategories, const char *const categories[])
{
    if (!instance_begin(c, CALL(fmi2SetDebugLogging))) {
        return STATUS_ERROR;
    }
    return instance_switch_logging(c, loggingOn != 0, nCategories, categories);
}

/* ---- Modes ---- */

Status fmi2SetupExperiment(void *c, int toleranceDefined, double tolerance, double startTime, int stopTimeDefined,
                           double stopTime)
{
    if (!instance_begin(c, CALL(fmi2SetupExperiment))) {
        return STATUS_ERROR;
    }
    return instance_set_up_experiment(c, toleranceDefined != 0, tolerance, startTime, stopTimeDefined != 0, stopTime);
}

Status fmi2EnterInitializationMode(void *c)
{
    if (!instance_begin(c, CALL(fmi2EnterInitializationMode))) {
        return STATUS_ERROR;
    }
    return instance_enter_initialization_mode(c);
}

Status fmi2ExitInitializationMode(void *c)
{
    if (!instance_begin(c, CALL(fmi2ExitInitializationMode))) {
        return STATUS_ERROR;
    }
    return instance_exit_initialization_mode(c);
}

Status fmi2Terminate(void *c)
{
    Instance *instance = c;
    if (!instance_begin(instance, CALL(fmi2Terminate))) {
        return STATUS_ERROR;
    }
    instance->now.state = STATE_TERMINATED;
    return STATUS_OK;
}

Status fmi2Reset(void *c)
{
    if (!instance_begin(c, CALL(fmi2Reset))) {
        return STATUS_ERROR;
    }
    instance_reset(c);
    return STATUS_OK;
}

/* ---- Values ---- */

Status fmi2GetReal(void *c, const uint32_t vr[], size_t nvr, double value[])
{
    if (!instance_begin(c, CALL(fmi2GetReal)) || instance_lacks(c, vr, nvr, "vr") ||
        instance_lacks(c, value, nvr, "value")) {
        return STATUS_ERROR;
    }
    return instance_get_real(c, vr, nvr, value);
}

Status fmi2GetInteger(void *c, const uint32_t vr[], size_t nvr, int32_t value[])
{
    if (!instance_begin(c, CALL(fmi2GetInteger)) || instance_lacks(c, vr, nvr, "vr") ||
        instance_lacks(c, value, nvr, "value")) {
        return STATUS_ERROR;
    }
    return instance_get_integer(c, vr, nvr, value);
}

Status fmi2GetBoolean(void *c, const uint32_t vr[], size_t nvr, int value[])
{
    if (!instance_begin(c, CALL(fmi2GetBoolean)) || instance_lacks(c, vr, nvr, "vr") ||
        instance_lacks(c, value, nvr, "value") || instance_check_booleans(c, vr, nvr) != STATUS_OK) {
        return STATUS_ERROR;
    }
    for (size_t i = 0; i < nvr; i++) {
        value[i] = instance_boolean(c, vr[i]) ? 1 : 0;
    }
    return STATUS_OK;
}

Status fmi2GetString(void *c, const uint32_t vr[], size_t nvr, const char *value[])
{
    (void)vr;
    (void)value;
    if (!instance_begin(c, CALL(fmi2GetString))) {
        return STATUS_ERROR;
    }
    return instance_no_variables(c, "String", nvr);
}

Status fmi2SetReal(void *c, const uint32_t vr[], size_t nvr, const double value[])
{
    if (!instance_begin(c, CALL(fmi2SetReal)) || instance_lacks(c, vr, nvr, "vr") ||
        instance_lacks(c, value, nvr, "value")) {
        return STATUS_ERROR;
    }
    return instance_set_real(c, vr, nvr, value);
}

Status fmi2SetInteger(void *c, const uint32_t vr[], size_t nvr, const int32_t value[])
{
    if (!instance_begin(c, CALL(fmi2SetInteger)) || instance_lacks(c, vr, nvr, "vr") ||
        instance_lacks(c, value, nvr, "value")) {
        return STATUS_ERROR;
    }
    return instance_set_integer(c, vr, nvr, value);
}

Status fmi2SetBoolean(void *c, const uint32_t vr[], size_t nvr, const int value[])
{
    if (!instance_begin(c, CALL(fmi2SetBoolean)) || instance_lacks(c, vr, nvr, "vr") ||
        instance_lacks(c, value, nvr, "value") || instance_check_set_boolean(c, vr, nvr) != STATUS_OK) {
        return STATUS_ERROR;
    }
    if (nvr > 0) {
        instance_use_measured(c, value[nvr - 1] != 0);
    }
    return STATUS_OK;
}

Status fmi2SetString(void *c, const uint32_t vr[], size_t nvr, const char *const value[])
{
    (void)vr;
    (void)value;
    if (!instance_begin(c, CALL(fmi2SetString))) {
        return STATUS_ERROR;
    }
    return instance_no_variables(c, "String", nvr);
}

/* ---- FMU state ---- */

/* Returns the state that FMUstate points to, a new one if there is none; null after a message if there is no memory. */
static Snapshot *state_at(Component *component, void **FMUstate)
{
    if (instance_lacks(&component->instance, FMUstate, 1, "FMUstate")) {
        return NULL;
    }
    if (*FMUstate == NULL) {
        *FMUstate = component->allocate(1, sizeof(Snapshot));
    }
    if (*FMUstate == NULL) {
        instance_tell(&component->instance, STATUS_ERROR, "no memory for a state");
    }
    return *FMUstate;
}

Status fmi2GetFMUstate(void *c, void **FMUstate)
{
    if (!instance_begin(c, CALL(fmi2GetFMUstate))) {
        return STATUS_ERROR;
    }
    Snapshot *state = state_at(c, FMUstate);
    if (state == NULL) {
        return STATUS_ERROR;
    }
    instance_save(c, state);
    return STATUS_OK;
}

Status fmi2SetFMUstate(void *c, void *FMUstate)
{
    if (!instance_begin(c, CALL(fmi2SetFMUstate)) || instance_lacks(c, FMUstate, 1, "FMUstate")) {
        return STATUS_ERROR;
    }
    return instance_restore(c, FMUstate);
}

Status fmi2FreeFMUstate(void *c, void **FMUstate)
{
    const Component *component = c;
    if (!instance_begin(c, CALL(fmi2FreeFMUstate))) {
        return STATUS_ERROR;
    }
    if (FMUstate != NULL && *FMUstate != NULL) {
        component->release(*FMUstate);
        *FMUstate = NULL;
    }
    return STATUS_OK;
}

Status fmi2SerializedFMUstateSize(void *c, void *FMUstate, size_t *size)
{
    if (!instance_begin(c, CALL(fmi2SerializedFMUstateSize)) || instance_lacks(c, FMUstate, 1, "FMUstate") ||
        instance_lacks(c, size, 1, "size")) {
        return STATUS_ERROR;
    }
    *size = snapshot_size();
    return STATUS_OK;
}

Status fmi2SerializeFMUstate(void *c, void *FMUstate, char serializedState[], size_t size)
{
    if (!instance_begin(c, CALL(fmi2SerializeFMUstate)) || instance_lacks(c, FMUstate, 1, "FMUstate")) {
        return STATUS_ERROR;
    }
    return instance_serialize(c, FMUstate, (uint8_t *)serializedState, size);
}

Status fmi2DeSerializeFMUstate(void *c, const char serializedState[], size_t size, void **FMUstate)
{
    Snapshot state;
    if (!instance_begin(c, CALL(fmi2DeSerializeFMUstate)) ||
        instance_lacks(c, serializedState, size, "serializedState") ||
        instance_deserialize(c, (const uint8_t *)serializedState, size, &state) != STATUS_OK) {
        return STATUS_ERROR;
    }
    Snapshot *to = state_at(c, FMUstate);
    if (to == NULL) {
        return STATUS_ERROR;
    }
    *to = state;
    return STATUS_OK;
}

/* ---- Derivatives ---- */

Status fmi2GetDirectionalDerivative(void *c, const uint32_t vUnknown_ref[], size_t nUnknown,
                                    const uint32_t vKnown_ref[], size_t nKnown, const double dvKnown[],
                                    double dvUnknown[])
{
    if (!instance_begin(c, CALL(fmi2GetDirectionalDerivative)) ||
        instance_lacks(c, vUnknown_ref, nUnknown, "vUnknown_ref") ||
        instance_lacks(c, vKnown_ref, nKnown, "vKnown_ref") || instance_lacks(c, dvKnown, nKnown, "dvKnown") ||
        instance_lacks(c, dvUnknown, nUnknown, "dvUnknown")) {
        return STATUS_ERROR;
    }
    return instance_directional_derivative(c, vUnknown_ref, nUnknown, vKnown_ref, nKnown, dvKnown, dvUnknown);
}

Status fmi2SetRealInputDerivatives(void *c, const uint32_t vr[], size_t nvr, const int32_t order[],
                                   const double value[])
{
    if (!instance_begin(c, CALL(fmi2SetRealInputDerivatives)) || instance_lacks(c, vr, nvr, "vr") ||
        instance_lacks(c, order, nvr, "order") || instance_lacks(c, value, nvr, "value")) {
        return STATUS_ERROR;
    }
    return instance_set_input_derivatives(c, vr, nvr, order, value);
}

Status fmi2GetRealOutputDerivatives(void *c, const uint32_t vr[], size_t nvr, const int32_t order[], double value[])
{
    if (!instance_begin(c, CALL(fmi2GetRealOutputDerivatives)) ||
        instance_lacks(c, vr, nvr, "vr") || instance_lacks(c, order, nvr, "order") ||
        instance_lacks(c, value, nvr, "value")) {
        return STATUS_ERROR;
    }
    return instance_output_derivatives(c, vr, nvr, order, value);
}

/* ---- Model exchange: no events ---- */

Status fmi2EnterEventMode(void *c)
{
    if (!instance_begin(c, CALL(fmi2EnterEventMode))) {
        return STATUS_ERROR;
    }
    return instance_enter_event_mode(c);
}

Status fmi2NewDiscreteStates(void *c, fmi2EventInfo *fmi2eventInfo)
{
    if (!instance_begin(c, CALL(fmi2NewDiscreteStates)) ||
        instance_lacks(c, fmi2eventInfo, 1, "fmi2eventInfo")) {
        return STATUS_ERROR;
    }
    *fmi2eventInfo = (fmi2EventInfo){0, 0, 0, 0, 0, 0.0};
    return STATUS_OK;
}

Status fmi2EnterContinuousTimeMode(void *c)
{
    Instance *instance = c;
    if (!instance_begin(instance, CALL(fmi2EnterContinuousTimeMode))) {
        return STATUS_ERROR;
    }
    instance->now.state = STATE_CONTINUOUS_TIME;
    return STATUS_OK;
}

Status fmi2CompletedIntegratorStep(void *c, int noSetFMUStatePriorToCurrentPoint, int *enterEventMode,
                                   int *terminateSimulation)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!instance_begin(c, CALL(fmi2CompletedIntegratorStep)) ||
        instance_lacks(c, enterEventMode, 1, "enterEventMode") ||
        instance_lacks(c, terminateSimulation, 1, "terminateSimulation")) {
        return STATUS_ERROR;
    }
    *enterEventMode = 0;
    *terminateSimulation = 0;
    return instance_accept_point(c);
}

Status fmi2SetTime(void *c, double time)
{
    if (!instance_begin(c, CALL(fmi2SetTime))) {
        return STATUS_ERROR;
    }
    return instance_set_solver_time(c, time);
}

/* Returns true, after a message, unless the arguments are one number for each state. */
static bool bad_states(Instance *instance, const double values[], size_t count, const char *argument)
{
    return instance_miscounts(instance, count, STATE_COUNT, argument) ||
           instance_lacks(instance, values, count, argument);
}

Status fmi2SetContinuousStates(void *c, const double x[], size_t nx)
{
    if (!instance_begin(c, CALL(fmi2SetContinuousStates)) ||
        bad_states(c, x, nx, "x")) {
        return STATUS_ERROR;
    }
    return instance_set_states(c, x);
}

Status fmi2GetDerivatives(void *c, double derivatives[], size_t nx)
{
    if (!instance_begin(c, CALL(fmi2GetDerivatives)) || bad_states(c, derivatives, nx, "derivatives")) {
        return STATUS_ERROR;
    }
    return instance_get_derivatives(c, derivatives);
}

Status fmi2GetEventIndicators(void *c, double eventIndicators[], size_t ni)
{
    (void)eventIndicators;
    if (!instance_begin(c, CALL(fmi2GetEventIndicators)) ||
        instance_miscounts(c, ni, 0, "eventIndicators")) {
        return STATUS_ERROR;
    }
    return STATUS_OK;
}

Status fmi2GetContinuousStates(void *c, double x[], size_t nx)
{
    if (!instance_begin(c, CALL(fmi2GetContinuousStates)) || bad_states(c, x, nx, "x")) {
        return STATUS_ERROR;
    }
    instance_get_states(c, x);
    return STATUS_OK;
}

Status fmi2GetNominalsOfContinuousStates(void *c, double x_nominal[], size_t nx)
{
    if (!instance_begin(c, CALL(fmi2GetNominalsOfContinuousStates)) ||
        bad_states(c, x_nominal, nx, "x_nominal")) {
        return STATUS_ERROR;
    }
    instance_get_nominals(x_nominal);
    return STATUS_OK;
}

/* ---- Co-simulation: steps are synchronous and always complete ---- */

Status fmi2DoStep(void *c, double currentCommunicationPoint, double communicationStepSize,
                  int noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!instance_begin(c, CALL(fmi2DoStep))) {
        return STATUS_ERROR;
    }
    return instance_do_step(c, currentCommunicationPoint, communicationStepSize);
}

Status fmi2CancelStep(void *c)
{
    instance_begin(c, CALL(fmi2CancelStep));
    return STATUS_ERROR;
}

/* "If a status is required which cannot be retrieved by the slave it returns fmi2Discard." */
static Status no_status(void *c, int kind)
{
    return instance_tell(c, STATUS_DISCARD,
                         "status information %d is not available: steps are synchronous and always complete", kind);
}

Status fmi2GetStatus(void *c, fmi2StatusKind s, Status *value)
{
    (void)value;
    return instance_begin(c, CALL(fmi2GetStatus)) ? no_status(c, s) : STATUS_ERROR;
}

Status fmi2GetRealStatus(void *c, fmi2StatusKind s, double *value)
{
    const Instance *instance = c;
    if (!instance_begin(c, CALL(fmi2GetRealStatus))) {
        return STATUS_ERROR;
    }
    if (s != fmi2LastSuccessfulTime) {
        return no_status(c, s);
    }
    if (instance_lacks(c, value, 1, "value")) {
        return STATUS_ERROR;
    }
    *value = instance->now.time;
    return STATUS_OK;
}

Status fmi2GetIntegerStatus(void *c, fmi2StatusKind s, int *value)
{
    (void)value;
    return instance_begin(c, CALL(fmi2GetIntegerStatus)) ? no_status(c, s) : STATUS_ERROR;
}

Status fmi2GetBooleanStatus(void *c, fmi2StatusKind s, int *value)
{
    if (!instance_begin(c, CALL(fmi2GetBooleanStatus))) {
        return STATUS_ERROR;
    }
    if (s != fmi2Terminated) {
        return no_status(c, s);
    }
    if (instance_lacks(c, value, 1, "value")) {
        return STATUS_ERROR;
    }
    *value = 0;
    return STATUS_OK;
}

Status fmi2GetStringStatus(void *c, fmi2StatusKind s, const char **value)
{
    (void)value;
    return instance_begin(c, CALL(fmi2GetStringStatus)) ? no_status(c, s) : STATUS_ERROR;
}

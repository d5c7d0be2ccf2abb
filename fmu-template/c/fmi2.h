/*
 * C interface of FMI 2.0: types and functions of the standard. Prototypes have the plain C types that the standard's
 * names stand for.
 *
 * Names are those of a shared library, unless FMI2_FUNCTION_PREFIX is defined, as for statically linked FMUs.
 * FMI2_OVERRIDE_FUNCTION_PREFIX cancels it.
 */
#ifndef FMI2_H
#define FMI2_H

#include "instance.h"

#if defined(FMI2_FUNCTION_PREFIX) && !defined(FMI2_OVERRIDE_FUNCTION_PREFIX)
#define FMI2_JOIN(prefix, name) prefix##name
#define FMI2_EXPAND(prefix, name) FMI2_JOIN(prefix, name)
#define FMI2_NAME(name) FMI2_EXPAND(FMI2_FUNCTION_PREFIX, name)
#else
#define FMI2_NAME(name) name
#endif

#if !defined(FMI2_Export)
#if defined(_WIN32) || defined(__CYGWIN__)
#define FMI2_Export __declspec(dllexport)
#elif defined(__GNUC__)
#define FMI2_Export __attribute__((visibility("default")))
#else
#define FMI2_Export
#endif
#endif

#define fmi2GetTypesPlatform FMI2_NAME(fmi2GetTypesPlatform)
#define fmi2GetVersion FMI2_NAME(fmi2GetVersion)
#define fmi2Instantiate FMI2_NAME(fmi2Instantiate)
#define fmi2FreeInstance FMI2_NAME(fmi2FreeInstance)
#define fmi2SetDebugLogging FMI2_NAME(fmi2SetDebugLogging)
#define fmi2SetupExperiment FMI2_NAME(fmi2SetupExperiment)
#define fmi2EnterInitializationMode FMI2_NAME(fmi2EnterInitializationMode)
#define fmi2ExitInitializationMode FMI2_NAME(fmi2ExitInitializationMode)
#define fmi2Terminate FMI2_NAME(fmi2Terminate)
#define fmi2Reset FMI2_NAME(fmi2Reset)
#define fmi2GetReal FMI2_NAME(fmi2GetReal)
#define fmi2GetInteger FMI2_NAME(fmi2GetInteger)
#define fmi2GetBoolean FMI2_NAME(fmi2GetBoolean)
#define fmi2GetString FMI2_NAME(fmi2GetString)
#define fmi2SetReal FMI2_NAME(fmi2SetReal)
#define fmi2SetInteger FMI2_NAME(fmi2SetInteger)
#define fmi2SetBoolean FMI2_NAME(fmi2SetBoolean)
#define fmi2SetString FMI2_NAME(fmi2SetString)
#define fmi2GetFMUstate FMI2_NAME(fmi2GetFMUstate)
#define fmi2SetFMUstate FMI2_NAME(fmi2SetFMUstate)
#define fmi2FreeFMUstate FMI2_NAME(fmi2FreeFMUstate)
#define fmi2SerializedFMUstateSize FMI2_NAME(fmi2SerializedFMUstateSize)
#define fmi2SerializeFMUstate FMI2_NAME(fmi2SerializeFMUstate)
#define fmi2DeSerializeFMUstate FMI2_NAME(fmi2DeSerializeFMUstate)
#define fmi2GetDirectionalDerivative FMI2_NAME(fmi2GetDirectionalDerivative)
#define fmi2EnterEventMode FMI2_NAME(fmi2EnterEventMode)
#define fmi2NewDiscreteStates FMI2_NAME(fmi2NewDiscreteStates)
#define fmi2EnterContinuousTimeMode FMI2_NAME(fmi2EnterContinuousTimeMode)
#define fmi2CompletedIntegratorStep FMI2_NAME(fmi2CompletedIntegratorStep)
#define fmi2SetTime FMI2_NAME(fmi2SetTime)
#define fmi2SetContinuousStates FMI2_NAME(fmi2SetContinuousStates)
#define fmi2GetDerivatives FMI2_NAME(fmi2GetDerivatives)
#define fmi2GetEventIndicators FMI2_NAME(fmi2GetEventIndicators)
#define fmi2GetContinuousStates FMI2_NAME(fmi2GetContinuousStates)
#define fmi2GetNominalsOfContinuousStates FMI2_NAME(fmi2GetNominalsOfContinuousStates)
#define fmi2SetRealInputDerivatives FMI2_NAME(fmi2SetRealInputDerivatives)
#define fmi2GetRealOutputDerivatives FMI2_NAME(fmi2GetRealOutputDerivatives)
#define fmi2DoStep FMI2_NAME(fmi2DoStep)
#define fmi2CancelStep FMI2_NAME(fmi2CancelStep)
#define fmi2GetStatus FMI2_NAME(fmi2GetStatus)
#define fmi2GetRealStatus FMI2_NAME(fmi2GetRealStatus)
#define fmi2GetIntegerStatus FMI2_NAME(fmi2GetIntegerStatus)
#define fmi2GetBooleanStatus FMI2_NAME(fmi2GetBooleanStatus)
#define fmi2GetStringStatus FMI2_NAME(fmi2GetStringStatus)

#define fmi2TypesPlatform "default"
#define fmi2True 1
#define fmi2False 0

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef uint32_t fmi2ValueReference;
typedef double fmi2Real;
typedef int32_t fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Char;
typedef const fmi2Char *fmi2String;
typedef char fmi2Byte;

typedef Status fmi2Status;
#define fmi2OK STATUS_OK
#define fmi2Warning STATUS_WARNING
#define fmi2Discard STATUS_DISCARD
#define fmi2Error STATUS_ERROR
#define fmi2Fatal STATUS_FATAL
#define fmi2Pending STATUS_PENDING

typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;

typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;

/* Sends a message to the host. `message` is a printf format for the arguments after it. */
typedef void (*fmi2CallbackLogger)(fmi2ComponentEnvironment componentEnvironment, fmi2String instanceName,
                                   fmi2Status status, fmi2String category, fmi2String message, ...);
typedef void *(*fmi2CallbackAllocateMemory)(size_t nobj, size_t size);
typedef void (*fmi2CallbackFreeMemory)(void *obj);
typedef void (*fmi2StepFinished)(fmi2ComponentEnvironment componentEnvironment, fmi2Status status);

typedef struct {
    fmi2CallbackLogger logger;
    fmi2CallbackAllocateMemory allocateMemory;
    fmi2CallbackFreeMemory freeMemory;
    fmi2StepFinished stepFinished;
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

typedef struct {
    int newDiscreteStatesNeeded;
    int terminateSimulation;
    int nominalsOfContinuousStatesChanged;
    int valuesOfContinuousStatesChanged;
    int nextEventTimeDefined;
    double nextEventTime; /* s */
} fmi2EventInfo;

FMI2_Export const char *fmi2GetTypesPlatform(void);
FMI2_Export const char *fmi2GetVersion(void);
FMI2_Export void *fmi2Instantiate(const char *instanceName, fmi2Type fmuType, const char *fmuGUID,
                                  const char *fmuResourceLocation, const fmi2CallbackFunctions *functions,
                                  int visible, int loggingOn);
FMI2_Export void fmi2FreeInstance(void *c);
FMI2_Export Status fmi2SetDebugLogging(void *c, int loggingOn, size_t nCategories, const char *const categories[]);
FMI2_Export Status fmi2SetupExperiment(void *c, int toleranceDefined, double tolerance, double startTime,
                                       int stopTimeDefined, double stopTime);
FMI2_Export Status fmi2EnterInitializationMode(void *c);
FMI2_Export Status fmi2ExitInitializationMode(void *c);
FMI2_Export Status fmi2Terminate(void *c);
FMI2_Export Status fmi2Reset(void *c);
FMI2_Export Status fmi2GetReal(void *c, const uint32_t vr[], size_t nvr, double value[]);
FMI2_Export Status fmi2GetInteger(void *c, const uint32_t vr[], size_t nvr, int32_t value[]);
FMI2_Export Status fmi2GetBoolean(void *c, const uint32_t vr[], size_t nvr, int value[]);
FMI2_Export Status fmi2GetString(void *c, const uint32_t vr[], size_t nvr, const char *value[]);
FMI2_Export Status fmi2SetReal(void *c, const uint32_t vr[], size_t nvr, const double value[]);
FMI2_Export Status fmi2SetInteger(void *c, const uint32_t vr[], size_t nvr, const int32_t value[]);
FMI2_Export Status fmi2SetBoolean(void *c, const uint32_t vr[], size_t nvr, const int value[]);
FMI2_Export Status fmi2SetString(void *c, const uint32_t vr[], size_t nvr, const char *const value[]);
FMI2_Export Status fmi2GetFMUstate(void *c, void **FMUstate);
FMI2_Export Status fmi2SetFMUstate(void *c, void *FMUstate);
FMI2_Export Status fmi2FreeFMUstate(void *c, void **FMUstate);
FMI2_Export Status fmi2SerializedFMUstateSize(void *c, void *FMUstate, size_t *size);
FMI2_Export Status fmi2SerializeFMUstate(void *c, void *FMUstate, char serializedState[], size_t size);
FMI2_Export Status fmi2DeSerializeFMUstate(void *c, const char serializedState[], size_t size, void **FMUstate);
FMI2_Export Status fmi2GetDirectionalDerivative(void *c, const uint32_t vUnknown_ref[], size_t nUnknown,
                                                const uint32_t vKnown_ref[], size_t nKnown, const double dvKnown[],
                                                double dvUnknown[]);
FMI2_Export Status fmi2EnterEventMode(void *c);
FMI2_Export Status fmi2NewDiscreteStates(void *c, fmi2EventInfo *fmi2eventInfo);
FMI2_Export Status fmi2EnterContinuousTimeMode(void *c);
FMI2_Export Status fmi2CompletedIntegratorStep(void *c, int noSetFMUStatePriorToCurrentPoint, int *enterEventMode,
                                               int *terminateSimulation);
FMI2_Export Status fmi2SetTime(void *c, double time);
FMI2_Export Status fmi2SetContinuousStates(void *c, const double x[], size_t nx);
FMI2_Export Status fmi2GetDerivatives(void *c, double derivatives[], size_t nx);
FMI2_Export Status fmi2GetEventIndicators(void *c, double eventIndicators[], size_t ni);
FMI2_Export Status fmi2GetContinuousStates(void *c, double x[], size_t nx);
FMI2_Export Status fmi2GetNominalsOfContinuousStates(void *c, double x_nominal[], size_t nx);
FMI2_Export Status fmi2SetRealInputDerivatives(void *c, const uint32_t vr[], size_t nvr, const int32_t order[],
                                               const double value[]);
FMI2_Export Status fmi2GetRealOutputDerivatives(void *c, const uint32_t vr[], size_t nvr, const int32_t order[],
                                                double value[]);
FMI2_Export Status fmi2DoStep(void *c, double currentCommunicationPoint, double communicationStepSize,
                              int noSetFMUStatePriorToCurrentPoint);
FMI2_Export Status fmi2CancelStep(void *c);
FMI2_Export Status fmi2GetStatus(void *c, fmi2StatusKind s, Status *value);
FMI2_Export Status fmi2GetRealStatus(void *c, fmi2StatusKind s, double *value);
FMI2_Export Status fmi2GetIntegerStatus(void *c, fmi2StatusKind s, int *value);
FMI2_Export Status fmi2GetBooleanStatus(void *c, fmi2StatusKind s, int *value);
FMI2_Export Status fmi2GetStringStatus(void *c, fmi2StatusKind s, const char **value);

#endif

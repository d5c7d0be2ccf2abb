/*
 * C interface of FMI 3.0: types and functions of the standard. Prototypes have the plain C types that the standard's
 * names stand for.
 *
 * Names are those of a shared library, unless FMI3_FUNCTION_PREFIX is defined, as for statically linked FMUs.
 * FMI3_OVERRIDE_FUNCTION_PREFIX cancels it.
 */
#ifndef FMI3_H
#define FMI3_H

#include "instance.h"

#if defined(FMI3_FUNCTION_PREFIX) && !defined(FMI3_OVERRIDE_FUNCTION_PREFIX)
#define FMI3_JOIN(prefix, name) prefix##name
#define FMI3_EXPAND(prefix, name) FMI3_JOIN(prefix, name)
#define FMI3_NAME(name) FMI3_EXPAND(FMI3_FUNCTION_PREFIX, name)
#else
#define FMI3_NAME(name) name
#endif

#if !defined(FMI3_Export)
#if defined(_WIN32) || defined(__CYGWIN__)
#define FMI3_Export __declspec(dllexport)
#elif defined(__GNUC__)
#define FMI3_Export __attribute__((visibility("default")))
#else
#define FMI3_Export
#endif
#endif

#define fmi3GetVersion FMI3_NAME(fmi3GetVersion)
#define fmi3SetDebugLogging FMI3_NAME(fmi3SetDebugLogging)
#define fmi3InstantiateModelExchange FMI3_NAME(fmi3InstantiateModelExchange)
#define fmi3InstantiateCoSimulation FMI3_NAME(fmi3InstantiateCoSimulation)
#define fmi3InstantiateScheduledExecution FMI3_NAME(fmi3InstantiateScheduledExecution)
#define fmi3FreeInstance FMI3_NAME(fmi3FreeInstance)
#define fmi3EnterInitializationMode FMI3_NAME(fmi3EnterInitializationMode)
#define fmi3ExitInitializationMode FMI3_NAME(fmi3ExitInitializationMode)
#define fmi3EnterEventMode FMI3_NAME(fmi3EnterEventMode)
#define fmi3Terminate FMI3_NAME(fmi3Terminate)
#define fmi3Reset FMI3_NAME(fmi3Reset)
#define fmi3GetFloat32 FMI3_NAME(fmi3GetFloat32)
#define fmi3GetFloat64 FMI3_NAME(fmi3GetFloat64)
#define fmi3GetInt8 FMI3_NAME(fmi3GetInt8)
#define fmi3GetUInt8 FMI3_NAME(fmi3GetUInt8)
#define fmi3GetInt16 FMI3_NAME(fmi3GetInt16)
#define fmi3GetUInt16 FMI3_NAME(fmi3GetUInt16)
#define fmi3GetInt32 FMI3_NAME(fmi3GetInt32)
#define fmi3GetUInt32 FMI3_NAME(fmi3GetUInt32)
#define fmi3GetInt64 FMI3_NAME(fmi3GetInt64)
#define fmi3GetUInt64 FMI3_NAME(fmi3GetUInt64)
#define fmi3GetBoolean FMI3_NAME(fmi3GetBoolean)
#define fmi3GetString FMI3_NAME(fmi3GetString)
#define fmi3GetBinary FMI3_NAME(fmi3GetBinary)
#define fmi3GetClock FMI3_NAME(fmi3GetClock)
#define fmi3SetFloat32 FMI3_NAME(fmi3SetFloat32)
#define fmi3SetFloat64 FMI3_NAME(fmi3SetFloat64)
#define fmi3SetInt8 FMI3_NAME(fmi3SetInt8)
#define fmi3SetUInt8 FMI3_NAME(fmi3SetUInt8)
#define fmi3SetInt16 FMI3_NAME(fmi3SetInt16)
#define fmi3SetUInt16 FMI3_NAME(fmi3SetUInt16)
#define fmi3SetInt32 FMI3_NAME(fmi3SetInt32)
#define fmi3SetUInt32 FMI3_NAME(fmi3SetUInt32)
#define fmi3SetInt64 FMI3_NAME(fmi3SetInt64)
#define fmi3SetUInt64 FMI3_NAME(fmi3SetUInt64)
#define fmi3SetBoolean FMI3_NAME(fmi3SetBoolean)
#define fmi3SetString FMI3_NAME(fmi3SetString)
#define fmi3SetBinary FMI3_NAME(fmi3SetBinary)
#define fmi3SetClock FMI3_NAME(fmi3SetClock)
#define fmi3GetNumberOfVariableDependencies FMI3_NAME(fmi3GetNumberOfVariableDependencies)
#define fmi3GetVariableDependencies FMI3_NAME(fmi3GetVariableDependencies)
#define fmi3GetFMUState FMI3_NAME(fmi3GetFMUState)
#define fmi3SetFMUState FMI3_NAME(fmi3SetFMUState)
#define fmi3FreeFMUState FMI3_NAME(fmi3FreeFMUState)
#define fmi3SerializedFMUStateSize FMI3_NAME(fmi3SerializedFMUStateSize)
#define fmi3SerializeFMUState FMI3_NAME(fmi3SerializeFMUState)
#define fmi3DeserializeFMUState FMI3_NAME(fmi3DeserializeFMUState)
#define fmi3GetDirectionalDerivative FMI3_NAME(fmi3GetDirectionalDerivative)
#define fmi3GetAdjointDerivative FMI3_NAME(fmi3GetAdjointDerivative)
#define fmi3EnterConfigurationMode FMI3_NAME(fmi3EnterConfigurationMode)
#define fmi3ExitConfigurationMode FMI3_NAME(fmi3ExitConfigurationMode)
#define fmi3GetIntervalDecimal FMI3_NAME(fmi3GetIntervalDecimal)
#define fmi3GetIntervalFraction FMI3_NAME(fmi3GetIntervalFraction)
#define fmi3GetShiftDecimal FMI3_NAME(fmi3GetShiftDecimal)
#define fmi3GetShiftFraction FMI3_NAME(fmi3GetShiftFraction)
#define fmi3SetIntervalDecimal FMI3_NAME(fmi3SetIntervalDecimal)
#define fmi3SetIntervalFraction FMI3_NAME(fmi3SetIntervalFraction)
#define fmi3SetShiftDecimal FMI3_NAME(fmi3SetShiftDecimal)
#define fmi3SetShiftFraction FMI3_NAME(fmi3SetShiftFraction)
#define fmi3EvaluateDiscreteStates FMI3_NAME(fmi3EvaluateDiscreteStates)
#define fmi3UpdateDiscreteStates FMI3_NAME(fmi3UpdateDiscreteStates)
#define fmi3EnterContinuousTimeMode FMI3_NAME(fmi3EnterContinuousTimeMode)
#define fmi3CompletedIntegratorStep FMI3_NAME(fmi3CompletedIntegratorStep)
#define fmi3SetTime FMI3_NAME(fmi3SetTime)
#define fmi3SetContinuousStates FMI3_NAME(fmi3SetContinuousStates)
#define fmi3GetContinuousStateDerivatives FMI3_NAME(fmi3GetContinuousStateDerivatives)
#define fmi3GetEventIndicators FMI3_NAME(fmi3GetEventIndicators)
#define fmi3GetContinuousStates FMI3_NAME(fmi3GetContinuousStates)
#define fmi3GetNominalsOfContinuousStates FMI3_NAME(fmi3GetNominalsOfContinuousStates)
#define fmi3GetNumberOfEventIndicators FMI3_NAME(fmi3GetNumberOfEventIndicators)
#define fmi3GetNumberOfContinuousStates FMI3_NAME(fmi3GetNumberOfContinuousStates)
#define fmi3EnterStepMode FMI3_NAME(fmi3EnterStepMode)
#define fmi3GetOutputDerivatives FMI3_NAME(fmi3GetOutputDerivatives)
#define fmi3DoStep FMI3_NAME(fmi3DoStep)
#define fmi3ActivateModelPartition FMI3_NAME(fmi3ActivateModelPartition)

#define fmi3True true
#define fmi3False false
#define fmi3ClockActive true
#define fmi3ClockInactive false

typedef void *fmi3Instance;
typedef void *fmi3InstanceEnvironment;
typedef void *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean;
typedef char fmi3Char;
typedef const fmi3Char *fmi3String;
typedef uint8_t fmi3Byte;
typedef const fmi3Byte *fmi3Binary;
typedef bool fmi3Clock;

typedef Status fmi3Status;
#define fmi3OK STATUS_OK
#define fmi3Warning STATUS_WARNING
#define fmi3Discard STATUS_DISCARD
#define fmi3Error STATUS_ERROR
#define fmi3Fatal STATUS_FATAL

typedef enum {
    fmi3Independent,
    fmi3Constant,
    fmi3Fixed,
    fmi3Tunable,
    fmi3Discrete,
    fmi3Dependent
} fmi3DependencyKind;

typedef enum { fmi3IntervalNotYetKnown, fmi3IntervalUnchanged, fmi3IntervalChanged } fmi3IntervalQualifier;

typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment instanceEnvironment, fmi3Status status,
                                       fmi3String category, fmi3String message);
typedef void (*fmi3ClockUpdateCallback)(void *instanceEnvironment);
typedef void (*fmi3IntermediateUpdateCallback)(void *instanceEnvironment, double intermediateUpdateTime,
                                               bool intermediateVariableSetRequested,
                                               bool intermediateVariableGetAllowed, bool intermediateStepFinished,
                                               bool canReturnEarly, bool *earlyReturnRequested,
                                               double *earlyReturnTime);
typedef void (*fmi3LockPreemptionCallback)(void);
typedef void (*fmi3UnlockPreemptionCallback)(void);

FMI3_Export const char *fmi3GetVersion(void);
FMI3_Export Status fmi3SetDebugLogging(void *instance, bool loggingOn, size_t nCategories,
                                       const char *const categories[]);
FMI3_Export void *fmi3InstantiateModelExchange(const char *instanceName, const char *instantiationToken,
                                               const char *resourcePath, bool visible, bool loggingOn,
                                               void *instanceEnvironment, fmi3LogMessageCallback logMessage);
FMI3_Export void *fmi3InstantiateCoSimulation(const char *instanceName, const char *instantiationToken,
                                              const char *resourcePath, bool visible, bool loggingOn,
                                              bool eventModeUsed, bool earlyReturnAllowed,
                                              const uint32_t requiredIntermediateVariables[],
                                              size_t nRequiredIntermediateVariables, void *instanceEnvironment,
                                              fmi3LogMessageCallback logMessage,
                                              fmi3IntermediateUpdateCallback intermediateUpdate);
FMI3_Export void *fmi3InstantiateScheduledExecution(const char *instanceName, const char *instantiationToken,
                                                    const char *resourcePath, bool visible, bool loggingOn,
                                                    void *instanceEnvironment, fmi3LogMessageCallback logMessage,
                                                    fmi3ClockUpdateCallback clockUpdate,
                                                    fmi3LockPreemptionCallback lockPreemption,
                                                    fmi3UnlockPreemptionCallback unlockPreemption);
FMI3_Export void fmi3FreeInstance(void *instance);
FMI3_Export Status fmi3EnterInitializationMode(void *instance, bool toleranceDefined, double tolerance,
                                               double startTime, bool stopTimeDefined, double stopTime);
FMI3_Export Status fmi3ExitInitializationMode(void *instance);
FMI3_Export Status fmi3EnterEventMode(void *instance);
FMI3_Export Status fmi3Terminate(void *instance);
FMI3_Export Status fmi3Reset(void *instance);
FMI3_Export Status fmi3GetFloat32(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                  float values[], size_t nValues);
FMI3_Export Status fmi3GetFloat64(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                  double values[], size_t nValues);
FMI3_Export Status fmi3GetInt8(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                               int8_t values[], size_t nValues);
FMI3_Export Status fmi3GetUInt8(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                uint8_t values[], size_t nValues);
FMI3_Export Status fmi3GetInt16(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                int16_t values[], size_t nValues);
FMI3_Export Status fmi3GetUInt16(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                 uint16_t values[], size_t nValues);
FMI3_Export Status fmi3GetInt32(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                int32_t values[], size_t nValues);
FMI3_Export Status fmi3GetUInt32(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                 uint32_t values[], size_t nValues);
FMI3_Export Status fmi3GetInt64(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                int64_t values[], size_t nValues);
FMI3_Export Status fmi3GetUInt64(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                 uint64_t values[], size_t nValues);
FMI3_Export Status fmi3GetBoolean(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                  bool values[], size_t nValues);
FMI3_Export Status fmi3GetString(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                 const char *values[], size_t nValues);
FMI3_Export Status fmi3GetBinary(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                 size_t valueSizes[], const uint8_t *values[], size_t nValues);
FMI3_Export Status fmi3GetClock(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                bool values[]);
FMI3_Export Status fmi3SetFloat32(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                  const float values[], size_t nValues);
FMI3_Export Status fmi3SetFloat64(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                  const double values[], size_t nValues);
FMI3_Export Status fmi3SetInt8(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                               const int8_t values[], size_t nValues);
FMI3_Export Status fmi3SetUInt8(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                const uint8_t values[], size_t nValues);
FMI3_Export Status fmi3SetInt16(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                const int16_t values[], size_t nValues);
FMI3_Export Status fmi3SetUInt16(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                 const uint16_t values[], size_t nValues);
FMI3_Export Status fmi3SetInt32(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                const int32_t values[], size_t nValues);
FMI3_Export Status fmi3SetUInt32(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                 const uint32_t values[], size_t nValues);
FMI3_Export Status fmi3SetInt64(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                const int64_t values[], size_t nValues);
FMI3_Export Status fmi3SetUInt64(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                 const uint64_t values[], size_t nValues);
FMI3_Export Status fmi3SetBoolean(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                  const bool values[], size_t nValues);
FMI3_Export Status fmi3SetString(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                 const char *const values[], size_t nValues);
FMI3_Export Status fmi3SetBinary(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                 const size_t valueSizes[], const uint8_t *const values[], size_t nValues);
FMI3_Export Status fmi3SetClock(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                const bool values[]);
FMI3_Export Status fmi3GetNumberOfVariableDependencies(void *instance, uint32_t valueReference, size_t *nDependencies);
FMI3_Export Status fmi3GetVariableDependencies(void *instance, uint32_t dependent, size_t elementIndicesOfDependent[],
                                               uint32_t independents[], size_t elementIndicesOfIndependents[],
                                               fmi3DependencyKind dependencyKinds[], size_t nDependencies);
FMI3_Export Status fmi3GetFMUState(void *instance, void **FMUState);
FMI3_Export Status fmi3SetFMUState(void *instance, void *FMUState);
FMI3_Export Status fmi3FreeFMUState(void *instance, void **FMUState);
FMI3_Export Status fmi3SerializedFMUStateSize(void *instance, void *FMUState, size_t *size);
FMI3_Export Status fmi3SerializeFMUState(void *instance, void *FMUState, uint8_t serializedState[], size_t size);
FMI3_Export Status fmi3DeserializeFMUState(void *instance, const uint8_t serializedState[], size_t size,
                                           void **FMUState);
FMI3_Export Status fmi3GetDirectionalDerivative(void *instance, const uint32_t unknowns[], size_t nUnknowns,
                                                const uint32_t knowns[], size_t nKnowns, const double seed[],
                                                size_t nSeed, double sensitivity[], size_t nSensitivity);
FMI3_Export Status fmi3GetAdjointDerivative(void *instance, const uint32_t unknowns[], size_t nUnknowns,
                                            const uint32_t knowns[], size_t nKnowns, const double seed[],
                                            size_t nSeed, double sensitivity[], size_t nSensitivity);
FMI3_Export Status fmi3EnterConfigurationMode(void *instance);
FMI3_Export Status fmi3ExitConfigurationMode(void *instance);
FMI3_Export Status fmi3GetIntervalDecimal(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                          double intervals[], fmi3IntervalQualifier qualifiers[]);
FMI3_Export Status fmi3GetIntervalFraction(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                           uint64_t counters[], uint64_t resolutions[], fmi3IntervalQualifier qualifiers[]);
FMI3_Export Status fmi3GetShiftDecimal(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                       double shifts[]);
FMI3_Export Status fmi3GetShiftFraction(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                        uint64_t counters[], uint64_t resolutions[]);
FMI3_Export Status fmi3SetIntervalDecimal(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                          const double intervals[]);
FMI3_Export Status fmi3SetIntervalFraction(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                           const uint64_t counters[], const uint64_t resolutions[]);
FMI3_Export Status fmi3SetShiftDecimal(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                       const double shifts[]);
FMI3_Export Status fmi3SetShiftFraction(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                        const uint64_t counters[], const uint64_t resolutions[]);
FMI3_Export Status fmi3EvaluateDiscreteStates(void *instance);
FMI3_Export Status fmi3UpdateDiscreteStates(void *instance, bool *discreteStatesNeedUpdate, bool *terminateSimulation,
                                            bool *nominalsOfContinuousStatesChanged,
                                            bool *valuesOfContinuousStatesChanged, bool *nextEventTimeDefined,
                                            double *nextEventTime);
FMI3_Export Status fmi3EnterContinuousTimeMode(void *instance);
FMI3_Export Status fmi3CompletedIntegratorStep(void *instance, bool noSetFMUStatePriorToCurrentPoint,
                                               bool *enterEventMode, bool *terminateSimulation);
FMI3_Export Status fmi3SetTime(void *instance, double time);
FMI3_Export Status fmi3SetContinuousStates(void *instance, const double continuousStates[], size_t nContinuousStates);
FMI3_Export Status fmi3GetContinuousStateDerivatives(void *instance, double derivatives[], size_t nContinuousStates);
FMI3_Export Status fmi3GetEventIndicators(void *instance, double eventIndicators[], size_t nEventIndicators);
FMI3_Export Status fmi3GetContinuousStates(void *instance, double continuousStates[], size_t nContinuousStates);
FMI3_Export Status fmi3GetNominalsOfContinuousStates(void *instance, double nominals[], size_t nContinuousStates);
FMI3_Export Status fmi3GetNumberOfEventIndicators(void *instance, size_t *nEventIndicators);
FMI3_Export Status fmi3GetNumberOfContinuousStates(void *instance, size_t *nContinuousStates);
FMI3_Export Status fmi3EnterStepMode(void *instance);
FMI3_Export Status fmi3GetOutputDerivatives(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                                            const int32_t orders[], double values[], size_t nValues);
FMI3_Export Status fmi3DoStep(void *instance, double currentCommunicationPoint, double communicationStepSize,
                              bool noSetFMUStatePriorToCurrentPoint, bool *eventHandlingNeeded,
                              bool *terminateSimulation, bool *earlyReturn, double *lastSuccessfulTime);
FMI3_Export Status fmi3ActivateModelPartition(void *instance, uint32_t clockReference, double activationTime);

#endif

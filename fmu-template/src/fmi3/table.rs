//! Legal calls in each state of FMI 3.0.

use crate::component::{Call, legal_calls};

legal_calls! {
    "fmi3",
    /// The "allowed function calls" of sections 2.3 (common states), 3.2 (model exchange) and 4.2 (co-simulation) of
    /// FMI 3.0, without the states of structural parameters, which never occur here. Which variables may be set in which
    /// state is for the instance to say. More is allowed where hosts do it and what they mean is plain: end what has ended,
    /// configure what has no structural parameters, and begin an event, or set time and states, in Event Mode.
    //                                   Instantiated
    //                                   | Initialization
    //                                   | | Event
    //                                   | | | ContinuousTime
    //                                   | | | | Step
    //                                   | | | | | Terminated
    //                                   | | | | | | Error, of FMI 2.0
    //                                   | | | | | | | IntermediateUpdate
    SetDebugLogging                 => b"x x x m c x - -",
    EnterConfigurationMode          => b"x - x - c - - -", // without effect: there are no structural parameters
    ExitConfigurationMode           => b"x - x - c - - -",
    EnterInitializationMode         => b"x - - - - - - -",
    ExitInitializationMode          => b"- x - - - - - -",
    EnterEventMode                  => b"- - x m c - - -",
    Terminate                       => b"x x x m c x - -",
    Reset                           => b"x x x m c x - -",
    GetFloat32                      => b"x x x m c x - c",
    GetFloat64                      => b"x x x m c x - c",
    GetInt8                         => b"x x x m c x - c",
    GetUInt8                        => b"x x x m c x - c",
    GetInt16                        => b"x x x m c x - c",
    GetUInt16                       => b"x x x m c x - c",
    GetInt32                        => b"x x x m c x - c",
    GetUInt32                       => b"x x x m c x - c",
    GetInt64                        => b"x x x m c x - c",
    GetUInt64                       => b"x x x m c x - c",
    GetBoolean                      => b"x x x m c x - c",
    GetString                       => b"x x x m c x - c",
    GetBinary                       => b"x x x m c x - c",
    GetClock                        => b"- - x - - - - -",
    SetFloat32                      => b"x x x m c - - c",
    SetFloat64                      => b"x x x m c - - c",
    SetInt8                         => b"x x x m c - - c",
    SetUInt8                        => b"x x x m c - - c",
    SetInt16                        => b"x x x m c - - c",
    SetUInt16                       => b"x x x m c - - c",
    SetInt32                        => b"x x x m c - - c",
    SetUInt32                       => b"x x x m c - - c",
    SetInt64                        => b"x x x m c - - c",
    SetUInt64                       => b"x x x m c - - c",
    SetBoolean                      => b"x x x m c - - c",
    SetString                       => b"x x x m c - - c",
    SetBinary                       => b"x x x m c - - c",
    SetClock                        => b"- - x - - - - -",
    GetNumberOfVariableDependencies => b"x x x m c x - c",
    GetVariableDependencies         => b"x x x m c x - c",
    GetFMUState                     => b"x x x m c x - -",
    SetFMUState                     => b"x x x m c x - -",
    FreeFMUState                    => b"x x x m c x - -",
    SerializedFMUStateSize          => b"x x x m c x - -",
    SerializeFMUState               => b"x x x m c x - -",
    DeserializeFMUState             => b"x x x m c x - -",
    GetDirectionalDerivative        => b"- x x m c x - -",
    GetAdjointDerivative            => b"- x x m c x - -",
    GetIntervalDecimal              => b"- x x - - - - -",
    GetIntervalFraction             => b"- x x - - - - -",
    GetShiftDecimal                 => b"- x - - - - - -",
    GetShiftFraction                => b"- x - - - - - -",
    SetIntervalDecimal              => b"- x x - - - - -",
    SetIntervalFraction             => b"- x x - - - - -",
    SetShiftDecimal                 => b"- x - - - - - -",
    SetShiftFraction                => b"- x - - - - - -",
    EvaluateDiscreteStates          => b"- - x - - - - -",
    UpdateDiscreteStates            => b"- - x - - - - -",
    EnterContinuousTimeMode         => b"- - m - - - - -",
    CompletedIntegratorStep         => b"- - - m - - - -",
    SetTime                         => b"- - m m - - - -",
    SetContinuousStates             => b"- m m m - - - -",
    GetContinuousStateDerivatives   => b"- m m m - m - -",
    GetEventIndicators              => b"- m m m - m - -",
    GetContinuousStates             => b"- m m m - m - -",
    GetNominalsOfContinuousStates   => b"- m m m - m - -",
    GetNumberOfEventIndicators      => b"m m m m - m - -", // the standard: Instantiated and Event Mode; hosts ask where they please
    GetNumberOfContinuousStates     => b"m m m m - m - -",
    EnterStepMode                   => b"- - c - - - - -",
    GetOutputDerivatives            => b"- - - - c c - c",
    DoStep                          => b"- - - - c - - -",
    ActivateModelPartition          => b"- - - - - - - -", // scheduled execution
}

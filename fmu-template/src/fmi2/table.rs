//! Legal calls in each state of FMI 2.0.

use crate::component::{Call, legal_calls};

legal_calls! {
    "fmi2",
    /// The tables of sections 3.2.3 (model exchange) and 4.2.4 (co-simulation) of FMI 2.0, without the states of
    /// asynchronous and of partial steps, which never occur here. Which variables may be set in which state is for the
    /// instance to say. More is allowed where hosts do it and what they mean is plain: end what has ended, read start values, set
    /// the time before the experiment, and states before the solver runs.
    //                                 Instantiated
    //                                 | Initialization
    //                                 | | Event
    //                                 | | | ContinuousTime
    //                                 | | | | Step
    //                                 | | | | | Terminated
    //                                 | | | | | | Error
    SetDebugLogging               => b"x x m m c x x",
    SetupExperiment               => b"x - - - - - -",
    EnterInitializationMode       => b"x - - - - - -",
    ExitInitializationMode        => b"- x - - - - -",
    Terminate                     => b"x x m m c x x",
    Reset                         => b"x x m m c x x",
    GetReal                       => b"x x m m c x x",
    GetInteger                    => b"x x m m c x x",
    GetBoolean                    => b"x x m m c x x",
    GetString                     => b"x x m m c x x",
    SetReal                       => b"x x m m c - -",
    SetInteger                    => b"x x m - c - -",
    SetBoolean                    => b"x x m - c - -",
    SetString                     => b"x x m - c - -",
    GetFMUstate                   => b"x x m m c x x",
    SetFMUstate                   => b"x x m m c x x",
    FreeFMUstate                  => b"x x m m c x x",
    SerializedFMUstateSize        => b"x x m m c x x",
    SerializeFMUstate             => b"x x m m c x x",
    DeSerializeFMUstate           => b"x x m m c x x",
    GetDirectionalDerivative      => b"- x m m c x x",
    EnterEventMode                => b"- - m m - - -", // the table has both, the figure the latter
    NewDiscreteStates             => b"- - m - - - -",
    EnterContinuousTimeMode       => b"- - m - - - -",
    CompletedIntegratorStep       => b"- - - m - - -",
    SetTime                       => b"m - m m - - -", // Event Mode: without use, but hosts do it
    SetContinuousStates           => b"- m m m - - -",
    GetEventIndicators            => b"- m m m - m m",
    GetContinuousStates           => b"- m m m - m m",
    GetDerivatives                => b"- m m m - m m",
    GetNominalsOfContinuousStates => b"m m m m - m m",
    SetRealInputDerivatives       => b"c c - - c - -",
    GetRealOutputDerivatives      => b"- - - - c c c",
    DoStep                        => b"- - - - c - -",
    CancelStep                    => b"- - - - - - -", // only while a step runs asynchronously
    GetStatus                     => b"- - - - c c -",
    GetRealStatus                 => b"- - - - c c -",
    GetIntegerStatus              => b"- - - - c c -",
    GetBooleanStatus              => b"- - - - c c -",
    GetStringStatus               => b"- - - - c c -",
}

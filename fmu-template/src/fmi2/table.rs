//! What a host may call in which state of FMI 2.0.

use crate::{component::Call, state::Row};

/// The functions that belong to an instance, without the prefix `fmi2`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Function {
    SetDebugLogging,
    SetupExperiment,
    EnterInitializationMode,
    ExitInitializationMode,
    Terminate,
    Reset,
    GetReal,
    GetInteger,
    GetBoolean,
    GetString,
    SetReal,
    SetInteger,
    SetBoolean,
    SetString,
    GetFMUstate,
    SetFMUstate,
    FreeFMUstate,
    SerializedFMUstateSize,
    SerializeFMUstate,
    DeSerializeFMUstate,
    GetDirectionalDerivative,
    EnterEventMode,
    NewDiscreteStates,
    EnterContinuousTimeMode,
    CompletedIntegratorStep,
    SetTime,
    SetContinuousStates,
    GetEventIndicators,
    GetContinuousStates,
    GetDerivatives,
    GetNominalsOfContinuousStates,
    SetRealInputDerivatives,
    GetRealOutputDerivatives,
    DoStep,
    CancelStep,
    GetStatus,
    GetRealStatus,
    GetIntegerStatus,
    GetBooleanStatus,
    GetStringStatus,
}

impl Call for Function {
    const PREFIX: &'static str = "fmi2";

    /// The tables of sections 3.2.3 (model exchange) and 4.2.4 (co-simulation) of FMI 2.0, without the states of
    /// asynchronous and of partial steps, which never occur here. Which variables may be set in which state is for the
    /// instance to say.
    #[rustfmt::skip]
    fn legal(self) -> Row {
        match self {
            //                                       Instantiated
            //                                       | Initialization
            //                                       | | Event
            //                                       | | | ContinuousTime
            //                                       | | | | Step
            //                                       | | | | | Terminated
            //                                       | | | | | | Error
            Self::SetDebugLogging               => b"x x m m c x x",
            Self::SetupExperiment               => b"x - - - - - -",
            Self::EnterInitializationMode       => b"x - - - - - -",
            Self::ExitInitializationMode        => b"- x - - - - -",
            Self::Terminate                     => b"- - m m c - -",
            Self::Reset                         => b"x x m m c x x",
            Self::GetReal                       => b"- x m m c x x",
            Self::GetInteger                    => b"- x m m c x x",
            Self::GetBoolean                    => b"- x m m c x x",
            Self::GetString                     => b"- x m m c x x",
            Self::SetReal                       => b"x x m m c - -",
            Self::SetInteger                    => b"x x m - c - -",
            Self::SetBoolean                    => b"x x m - c - -",
            Self::SetString                     => b"x x m - c - -",
            Self::GetFMUstate                   => b"x x m m c x x",
            Self::SetFMUstate                   => b"x x m m c x x",
            Self::FreeFMUstate                  => b"x x m m c x x",
            Self::SerializedFMUstateSize        => b"x x m m c x x",
            Self::SerializeFMUstate             => b"x x m m c x x",
            Self::DeSerializeFMUstate           => b"x x m m c x x",
            Self::GetDirectionalDerivative      => b"- x m m c x x",
            Self::EnterEventMode                => b"- - m m - - -", // the table has both, the figure the latter
            Self::NewDiscreteStates             => b"- - m - - - -",
            Self::EnterContinuousTimeMode       => b"- - m - - - -",
            Self::CompletedIntegratorStep       => b"- - - m - - -",
            Self::SetTime                       => b"- - m m - - -", // Event Mode: without use, but hosts do it
            Self::SetContinuousStates           => b"- - - m - - -",
            Self::GetEventIndicators            => b"- m m m - m m",
            Self::GetContinuousStates           => b"- m m m - m m",
            Self::GetDerivatives                => b"- m m m - m m",
            Self::GetNominalsOfContinuousStates => b"m m m m - m m",
            Self::SetRealInputDerivatives       => b"c c - - c - -",
            Self::GetRealOutputDerivatives      => b"- - - - c c c",
            Self::DoStep                        => b"- - - - c - -",
            Self::CancelStep                    => b"- - - - - - -", // only while a step runs asynchronously
            Self::GetStatus                     => b"- - - - c c -",
            Self::GetRealStatus                 => b"- - - - c c -",
            Self::GetIntegerStatus              => b"- - - - c c -",
            Self::GetBooleanStatus              => b"- - - - c c -",
            Self::GetStringStatus               => b"- - - - c c -",
        }
    }
}

//! The hosts that are known. Each rule was seen in a run of the version that is named, or read in its sources; docs/hosts.md has more on each host.

use super::{
    Effect::{Limited, NotLoaded, RunFails, WrongValues},
    Evidence, Host, HostRule, Offer,
    conditions::*,
};
use crate::fmi::{FmiVersion, InterfaceKind};

const CO_SIMULATION_2: Offer = Offer { version: FmiVersion::V2, interface: InterfaceKind::CoSimulation };
const CO_SIMULATION_3: Offer = Offer { version: FmiVersion::V3, interface: InterfaceKind::CoSimulation };
const MODEL_EXCHANGE_2: Offer = Offer { version: FmiVersion::V2, interface: InterfaceKind::ModelExchange };
const MODEL_EXCHANGE_3: Offer = Offer { version: FmiVersion::V3, interface: InterfaceKind::ModelExchange };

const fn rule(
    finds: fn(&super::facts::FmuFacts) -> Option<String>,
    effect: super::Effect,
    because: &'static str,
    instead: &'static str,
) -> HostRule {
    HostRule { finds, effect, because, instead }
}

const REPAIR: &str = "repair the description; `metafmu validate` has the lines";

/// Every host that loads a library.
const LIBRARY: &[HostRule] = &[
    rule(lacks_library, NotLoaded, "there is nothing to load", "export it for this platform, or compile its sources"),
    rule(is_broken, RunFails, "the FMU does not run here", "see what `metafmu validate` says"),
];

/// FMPy 0.3.32 checks a description when it reads it, and so do all hosts that are built on it.
const FMPY: &[HostRule] = &[
    rule(
        lacks_functions,
        NotLoaded,
        "the library must have all functions of the standard",
        "export them; they may return an error",
    ),
    rule(
        breaks_schema,
        NotLoaded,
        "FMPy refuses descriptions that break the schema",
        "validate=False where the host passes it on",
    ),
    rule(repeats_names, NotLoaded, "FMPy refuses names that two variables have", REPAIR),
    rule(lacks_starts, NotLoaded, "FMPy refuses variables that have no start value and need one", REPAIR),
    rule(has_starts_of_calculated, NotLoaded, "FMPy refuses start values of calculated variables", REPAIR),
    rule(
        has_continuous_others,
        NotLoaded,
        "FMPy refuses continuous variables that are not real; it is the default of FMI 2.0",
        REPAIR,
    ),
    rule(
        combines_what_is_not_allowed,
        NotLoaded,
        "FMPy refuses this combination of causality, variability and initial",
        REPAIR,
    ),
    rule(uses_unknown_units, NotLoaded, "FMPy refuses units that are not defined", REPAIR),
    rule(uses_unknown_display_units, NotLoaded, "FMPy refuses display units that are not defined", REPAIR),
    rule(uses_unknown_types, NotLoaded, "FMPy refuses declared types that are not defined", REPAIR),
    rule(lacks_independent, NotLoaded, "FMPy refuses FMUs of FMI 3.0 without exactly one independent variable", REPAIR),
    rule(repeats_references, NotLoaded, "FMPy refuses value references that two variables of FMI 3.0 have", REPAIR),
    rule(has_backslashes, NotLoaded, "FMPy refuses backslashes in the archive", "pack it again with forward slashes"),
    rule(has_colons, NotLoaded, "FMPy refuses colons and leading slashes in the archive", "rename the files"),
];

/// Hosts that read all outputs as real numbers.
const REAL_OUTPUTS: &[HostRule] = &[
    rule(
        has_other_outputs,
        RunFails,
        "the host reads all outputs as scalar real numbers",
        "make these outputs local or real",
    ),
    rule(
        has_other_outputs_that_hit_reals,
        WrongValues,
        "the host reads all outputs as real numbers, and shows the variable that has the same value reference",
        "make these outputs local or real",
    ),
];

/// Mistakes that the parser of FMI Library takes for fatal.
const FMI_LIBRARY: &[HostRule] = &[
    rule(uses_unknown_display_units, NotLoaded, "FMI Library refuses display units that are not defined", REPAIR),
    rule(counts_kinds_of_dependencies_wrongly, NotLoaded, "there must be as many kinds as dependencies", REPAIR),
];

/// Mistakes that end fmi4c, the reader of ecos, OMSimulator and Hopsan.
const FMI4C: &[HostRule] = &[
    rule(
        lacks_functions,
        NotLoaded,
        "the library must have all functions of the standard",
        "export them; they may return an error",
    ),
    rule(counts_kinds_of_dependencies_wrongly, NotLoaded, "there must be as many kinds as dependencies", REPAIR),
];

const UNWIRED: HostRule = rule(
    has_inputs_that_start_elsewhere,
    Limited,
    "inputs that nothing is wired to are set to zero, whatever their start value is",
    "wire a constant with the start value",
);

pub(super) const HOSTS: &[Host] = &[
    Host {
        name: "FMPy",
        version: "0.3.32",
        evidence: Evidence::Run,
        takes: &[CO_SIMULATION_2, CO_SIMULATION_3, MODEL_EXCHANGE_2, MODEL_EXCHANGE_3],
        rules: &[
            LIBRARY,
            FMPY,
            &[rule(
                has_text_outputs,
                Limited,
                "texts, bytes and clocks are not recorded",
                "read them through the instance",
            )],
        ],
    },
    Host {
        name: "pathsim-fmi",
        version: "0.1.1",
        evidence: Evidence::Run,
        takes: &[CO_SIMULATION_2, CO_SIMULATION_3],
        rules: &[
            LIBRARY,
            FMPY,
            REAL_OUTPUTS,
            &[
                rule(
                    has_other_inputs,
                    RunFails,
                    "the host sets all inputs as scalar real numbers",
                    "make them parameters or real",
                ),
                rule(
                    has_other_inputs_that_hit_reals,
                    WrongValues,
                    "the host sets all inputs as real numbers, and so the variable that has the same value reference",
                    "make them parameters or real",
                ),
                rule(lacks_step_size, Limited, "there is no step size", "CoSimulationFMU(path, dt=...)"),
                UNWIRED,
            ],
        ],
    },
    Host {
        name: "cofmupy",
        version: "1.0.0",
        evidence: Evidence::Run,
        takes: &[CO_SIMULATION_2, CO_SIMULATION_3],
        rules: &[
            LIBRARY,
            FMPY,
            REAL_OUTPUTS,
            &[
                rule(
                    has_inputs_beyond_booleans,
                    NotLoaded,
                    "the host sets inputs as scalar real numbers",
                    "make them parameters or real",
                ),
                rule(
                    |facts| if facts.version() == FmiVersion::V2 { has_other_inputs(facts) } else { None },
                    NotLoaded,
                    "the host sets inputs of FMI 2.0 as real numbers",
                    "make them parameters or real",
                ),
                UNWIRED,
            ],
        ],
    },
    Host {
        name: "gemseo-fmu",
        version: "3.1.1",
        evidence: Evidence::Run,
        takes: &[CO_SIMULATION_2, CO_SIMULATION_3],
        rules: &[
            LIBRARY,
            FMPY,
            &[
                rule(
                    has_text_starts,
                    NotLoaded,
                    "the host takes every start value for a number",
                    "start=\"0\" or \"1\" of Booleans, or input_names=[...], output_names=[...] without these variables",
                ),
                rule(
                    has_text_outputs,
                    RunFails,
                    "texts are not recorded",
                    "output_names=[...] without these variables",
                ),
                rule(
                    has_whole_numbers_to_set,
                    RunFails,
                    "the host sets inputs and parameters as real numbers",
                    "input_names=[...] without these variables",
                ),
                rule(
                    has_arrays_to_set,
                    RunFails,
                    "the host does not convert start values of arrays",
                    "input_names=[...] without these variables",
                ),
                rule(
                    has_bytes_to_set,
                    RunFails,
                    "the host does not convert bytes",
                    "input_names=[...] without these variables",
                ),
            ],
        ],
    },
    Host {
        name: "estim8",
        version: "0.1.6",
        evidence: Evidence::Run,
        takes: &[CO_SIMULATION_2, CO_SIMULATION_3, MODEL_EXCHANGE_2, MODEL_EXCHANGE_3],
        rules: &[
            LIBRARY,
            FMPY,
            &[
                rule(
                    has_exact_text_starts,
                    NotLoaded,
                    "the host takes every exact start value for a number",
                    "start=\"0\" or \"1\" of Booleans",
                ),
                rule(
                    has_constants,
                    RunFails,
                    "the host sets constants as parameters",
                    "leave constants out of the description",
                ),
                rule(
                    has_computed_texts,
                    RunFails,
                    "the host observes all variables, and texts are not recorded",
                    "simulate(..., observe=[...])",
                ),
                rule(
                    has_arrays,
                    RunFails,
                    "the host observes all variables, and takes scalars only",
                    "simulate(..., observe=[...])",
                ),
                rule(
                    |facts| {
                        if facts.offers(facts.version(), InterfaceKind::CoSimulation) {
                            Some(String::new())
                        } else {
                            None
                        }
                    },
                    Limited,
                    "model exchange is the default",
                    "FmuModel(path, fmi_type=\"CoSimulation\")",
                ),
            ],
        ],
    },
    Host {
        name: "sofirpy",
        version: "1.0.2",
        evidence: Evidence::Run,
        takes: &[CO_SIMULATION_2],
        rules: &[
            LIBRARY,
            FMPY,
            &[
                rule(
                    has_enumerated_outputs,
                    Limited,
                    "these outputs cannot be logged or connected",
                    "leave them out of parameters_to_log",
                ),
                rule(
                    has_text_outputs,
                    Limited,
                    "these outputs cannot be logged or connected",
                    "leave them out of parameters_to_log",
                ),
            ],
        ],
    },
    Host {
        name: "syssimx",
        version: "0.4.3",
        evidence: Evidence::Run,
        takes: &[CO_SIMULATION_2],
        rules: &[
            LIBRARY,
            FMPY,
            &[
                rule(
                    lacks_dependencies,
                    NotLoaded,
                    "the host needs the attribute `dependencies` of every unknown",
                    "write dependencies",
                ),
                rule(
                    has_inputs_that_start_elsewhere,
                    Limited,
                    "inputs begin at zero, whatever their start value is",
                    "component.set_inputs before the first step",
                ),
            ],
        ],
    },
    Host {
        name: "CasADi",
        version: "3.8.2",
        evidence: Evidence::Run,
        takes: &[MODEL_EXCHANGE_2, MODEL_EXCHANGE_3],
        rules: &[
            LIBRARY,
            REAL_OUTPUTS,
            &[
                rule(
                    has_dots_in_its_identifier,
                    NotLoaded,
                    "the host looks for a library with `_` instead of dots",
                    "an identifier without dots",
                ),
                rule(
                    writes_initial_of_inputs,
                    NotLoaded,
                    "the host refuses `initial` of inputs",
                    "leave it out: it is the default",
                ),
                rule(has_odd_parameters, NotLoaded, "the host takes fixed and tunable parameters only", REPAIR),
                rule(
                    calls_a_variable_time,
                    NotLoaded,
                    "the host takes `time` for the independent variable",
                    "rename the variable",
                ),
                rule(
                    lacks_dependencies_in_fmi_3,
                    NotLoaded,
                    "the host needs the attribute `dependencies` of every unknown",
                    "write dependencies",
                ),
                rule(
                    counts_kinds_of_dependencies_wrongly,
                    NotLoaded,
                    "there must be as many kinds as dependencies",
                    REPAIR,
                ),
                rule(
                    has_structural_parameters,
                    NotLoaded,
                    "the host does not know structural parameters",
                    "fixed dimensions",
                ),
                rule(has_texts_in_elements, NotLoaded, "the host does not read <Start>", "leave texts out"),
                rule(has_single_precision_to_set, NotLoaded, "the host does not know Float32", "Float64"),
                rule(
                    is_packed_in_a_rare_way,
                    NotLoaded,
                    "the host unpacks stored and deflated files only",
                    "pack it again",
                ),
                rule(
                    has_states_without_start,
                    Limited,
                    "DaeBuilder.start says 0 for states that the FMU initializes",
                    "set them to the values of another host",
                ),
                rule(has_events, Limited, "events are not handled", "only where no event happens"),
                rule(
                    has_tunable_parameters_in_fmi_3,
                    Limited,
                    "derivatives with respect to these parameters are zero, as no dependency lists them",
                    "FMI 2.0",
                ),
            ],
        ],
    },
    Host {
        name: "fmugym",
        version: "0.2.0",
        evidence: Evidence::Run,
        takes: &[CO_SIMULATION_2, CO_SIMULATION_3],
        rules: &[
            LIBRARY,
            FMPY,
            &[
                rule(
                    has_other_scalar_outputs,
                    RunFails,
                    "the host reads the outputs that are named as scalar real numbers",
                    "name real outputs only",
                ),
                rule(has_arrays, Limited, "only scalars can be named", "scalars"),
            ],
        ],
    },
    Host {
        name: "pathsim-fmi (model exchange)",
        version: "0.1.1",
        evidence: Evidence::Run,
        takes: &[MODEL_EXCHANGE_2, MODEL_EXCHANGE_3],
        rules: &[
            LIBRARY,
            FMPY,
            REAL_OUTPUTS,
            &[
                rule(
                    is_of_late_dymola,
                    NotLoaded,
                    "these FMUs need the event iteration after the initialization, which the host leaves out",
                    "CoSimulationFMU",
                ),
                rule(has_no_states, RunFails, "the host integrates states, and there are none", "CoSimulationFMU"),
                rule(
                    has_other_inputs,
                    RunFails,
                    "the host sets all inputs as scalar real numbers",
                    "make them parameters or real",
                ),
            ],
        ],
    },
    Host {
        name: "libcosim",
        version: "0.11 (libcosimpy 0.0.6)",
        evidence: Evidence::Run,
        takes: &[CO_SIMULATION_2],
        rules: &[LIBRARY, FMI_LIBRARY, &[rule(has_enumerations, Limited, "enumerations are left out", "integers")]],
    },
    Host {
        name: "ecos",
        version: "0.7.2 (ecospy)",
        evidence: Evidence::Run,
        takes: &[CO_SIMULATION_2, CO_SIMULATION_3],
        rules: &[
            LIBRARY,
            FMI4C,
            &[
                rule(has_clocks, NotLoaded, "the host crashes at clocks", "an FMU without clocks"),
                rule(has_enumerations, Limited, "enumerations cannot be read or set", "integers"),
                rule(has_arrays, Limited, "only one number of an array is read", "scalars"),
            ],
        ],
    },
    Host {
        name: "OMSimulator",
        version: "3.0.0 of November 2025",
        evidence: Evidence::Run,
        takes: &[CO_SIMULATION_2, MODEL_EXCHANGE_2, CO_SIMULATION_3],
        rules: &[
            LIBRARY,
            FMI4C,
            &[
                rule(
                    depends_on_reference_zero,
                    RunFails,
                    "the host takes the value reference 0 among dependencies for none",
                    "value references from 1",
                ),
                rule(has_arrays, RunFails, "the result of FMUs with arrays is empty", "scalars, or FMI 2.0"),
                rule(has_text_ports, Limited, "texts, bytes and clocks are left out", "numbers"),
            ],
        ],
    },
    Host {
        name: "PyFMI",
        version: "3.0-dev of April 2026",
        evidence: Evidence::Run,
        takes: &[MODEL_EXCHANGE_2, CO_SIMULATION_2, MODEL_EXCHANGE_3],
        rules: &[
            LIBRARY,
            FMI_LIBRARY,
            &[
                rule(
                    needs_another_program,
                    NotLoaded,
                    "the host runs no FMU that needs another program",
                    "a self-contained FMU",
                ),
                rule(has_arrays, RunFails, "the host takes scalars only", "scalars"),
            ],
        ],
    },
    Host {
        name: "fmusim",
        version: "0.7.0 of August 2026",
        evidence: Evidence::Run,
        takes: &[CO_SIMULATION_2, CO_SIMULATION_3, MODEL_EXCHANGE_2, MODEL_EXCHANGE_3],
        rules: &[
            LIBRARY,
            &[rule(
                combines_what_is_not_allowed,
                NotLoaded,
                "the host refuses this combination of causality and variability",
                REPAIR,
            )],
        ],
    },
    Host {
        name: "FMI Kit for Simulink",
        version: "of December 2024",
        evidence: Evidence::Read,
        takes: &[CO_SIMULATION_2, CO_SIMULATION_3, MODEL_EXCHANGE_2, MODEL_EXCHANGE_3],
        rules: &[&[
            rule(lacks_windows, Limited, "there is nothing to load on Windows", "export it for x86_64-windows"),
            rule(
                is_of_fmi_3,
                Limited,
                "on Linux the host looks for FMI 3.0 in binaries/linux64",
                "FMI 2.0, or a copy of the library there",
            ),
            rule(has_text_ports, Limited, "texts, bytes and clocks have no port", "numbers"),
        ]],
    },
    Host {
        name: "OpenModelica",
        version: "of August 2026 (importFMU)",
        evidence: Evidence::Read,
        takes: &[MODEL_EXCHANGE_2, MODEL_EXCHANGE_3],
        rules: &[
            LIBRARY,
            FMI_LIBRARY,
            &[
                rule(
                    has_names_that_become_one,
                    NotLoaded,
                    "dots and brackets become `_`, and names collide",
                    "other names",
                ),
                rule(has_arrays, Limited, "arrays are left out", "scalars"),
                rule(has_text_ports, Limited, "bytes and clocks are left out", "numbers"),
            ],
        ],
    },
    Host {
        name: "FMI.jl",
        version: "of June 2026",
        evidence: Evidence::Read,
        takes: &[MODEL_EXCHANGE_2, CO_SIMULATION_2, MODEL_EXCHANGE_3, CO_SIMULATION_3],
        rules: &[
            LIBRARY,
            &[
                rule(has_structural_parameters, NotLoaded, "the host reads fixed dimensions only", "fixed dimensions"),
                rule(has_arrays, Limited, "start values of arrays are not read", "scalars"),
            ],
        ],
    },
    Host {
        name: "preCICE fmi-runner",
        version: "of 2026",
        evidence: Evidence::Read,
        takes: &[CO_SIMULATION_2, CO_SIMULATION_3],
        rules: &[
            LIBRARY,
            FMPY,
            REAL_OUTPUTS,
            &[rule(cannot_put_its_state_back, Limited, "implicit coupling puts states back", "explicit coupling")],
        ],
    },
    Host {
        name: "Unity-FMI-Addon",
        version: "of 2018",
        evidence: Evidence::Read,
        takes: &[CO_SIMULATION_2],
        rules: &[&[rule(
            lacks_windows,
            NotLoaded,
            "the host runs on Windows and macOS",
            "export it for x86_64-windows",
        )]],
    },
    Host {
        name: "Hopsan",
        version: "of June 2026",
        evidence: Evidence::Read,
        takes: &[CO_SIMULATION_2, CO_SIMULATION_3],
        rules: &[
            LIBRARY,
            FMI4C,
            &[
                rule(has_text_ports, Limited, "texts, bytes and clocks have no port", "numbers"),
                rule(has_arrays, Limited, "arrays have no port", "scalars"),
                rule(
                    is_of_fmi_3,
                    Limited,
                    "the stop time that FMUs of FMI 3.0 are told is 10 s",
                    "FMI 2.0 for longer runs",
                ),
            ],
        ],
    },
    Host {
        name: "Twin Builder",
        version: "as its users report",
        evidence: Evidence::Read,
        takes: &[CO_SIMULATION_2, MODEL_EXCHANGE_2],
        rules: &[&[rule(has_dots_or_brackets, NotLoaded, "the host refuses dots and brackets in names", "flat names")]],
    },
    Host {
        name: "ROS fmi_adapter",
        version: "of 2022",
        evidence: Evidence::Read,
        takes: &[CO_SIMULATION_2],
        rules: &[
            LIBRARY,
            FMI_LIBRARY,
            &[
                rule(
                    has_both_interfaces,
                    NotLoaded,
                    "the host refuses FMUs with both interfaces",
                    "an FMU for co-simulation only",
                ),
                rule(lacks_step_size, Limited, "there is no step size", "give one to the adapter"),
                rule(
                    has_other_outputs,
                    RunFails,
                    "the host reads all outputs as real numbers",
                    "make these outputs local or real",
                ),
            ],
        ],
    },
];

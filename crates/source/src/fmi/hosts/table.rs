//! The hosts that are known. Each rule was seen in a run of the version that is named, or read in its sources; docs/hosts.md has more on each host.

use super::{
    Effect::{self, Limited, NotLoaded, RunFails, WrongValues},
    Evidence, Host, HostRule, Offer,
    conditions::Condition::{self, Text, Variables, Whole},
    variables::{
        combines_what_is_not_allowed, has_bytes_to_set, has_dots_or_brackets, has_exact_text_start, is_array,
        is_array_to_set, is_calculated_with_start, is_called_time, is_clock, is_computed_text, is_constant,
        is_continuous_but_not_real, is_enumerated_output, is_enumeration, is_input_beyond_booleans,
        is_input_but_not_real, is_input_of_fmi_2_but_not_real, is_input_that_hits_a_real,
        is_input_that_starts_elsewhere, is_input_with_initial, is_odd_parameter, is_output_but_not_real,
        is_output_that_hits_a_real, is_port_with_text_start, is_scalar_output_but_not_real, is_single_precision_to_set,
        is_structural_parameter, is_text_in_elements, is_text_output, is_text_port, is_whole_number_to_set,
        lacks_start, uses_unknown_display_unit, uses_unknown_type, uses_unknown_unit,
    },
    whole::{
        breaks_schema, cannot_put_its_state_back, counts_kinds_of_dependencies_wrongly, depends_on_reference_zero,
        has_backslashes, has_colons, has_dots_in_its_identifier, has_events, has_names_that_become_one, has_no_states,
        has_states_without_start, has_unlisted_parameters, is_broken, is_of_fmi_3, is_of_late_dymola,
        is_packed_in_a_rare_way, lacks_dependencies, lacks_dependencies_in_fmi_3, lacks_functions, lacks_independent,
        lacks_library, lacks_step_size, lacks_windows, needs_another_program, offers_both_interfaces,
        offers_co_simulation, repeats_names, repeats_references,
    },
};
use crate::fmi::{FmiVersion, InterfaceKind};

const CO_SIMULATION_2: Offer = Offer { version: FmiVersion::V2, interface: InterfaceKind::CoSimulation };
const CO_SIMULATION_3: Offer = Offer { version: FmiVersion::V3, interface: InterfaceKind::CoSimulation };
const MODEL_EXCHANGE_2: Offer = Offer { version: FmiVersion::V2, interface: InterfaceKind::ModelExchange };
const MODEL_EXCHANGE_3: Offer = Offer { version: FmiVersion::V3, interface: InterfaceKind::ModelExchange };

const fn rule(condition: Condition, effect: Effect, because: &'static str, instead: &'static str) -> HostRule {
    HostRule { condition, effect, because, instead }
}

/// A rule on arrays.
const fn arrays(effect: Effect, because: &'static str) -> HostRule {
    rule(Variables(is_array), effect, because, "scalars")
}

/// A rule on inputs and outputs that are texts, bytes or clocks.
const fn text_ports(because: &'static str) -> HostRule {
    rule(Variables(is_text_port), Limited, because, "numbers")
}

const REPAIR: &str = "repair the description; `metafmu validate` has the lines";

const MISSING_FUNCTIONS: HostRule = rule(
    Text(lacks_functions),
    NotLoaded,
    "the library must have all functions of the standard",
    "export them; they may return an error",
);

const WRONG_KINDS: HostRule =
    rule(Text(counts_kinds_of_dependencies_wrongly), NotLoaded, "there must be as many kinds as dependencies", REPAIR);

const REAL_INPUTS: HostRule = rule(
    Variables(is_input_but_not_real),
    RunFails,
    "the host sets all inputs as scalar real numbers",
    "make them parameters or real",
);

const NO_TEXT_PORTS: HostRule = text_ports("texts, bytes and clocks have no port");

/// Every host that loads a library.
const LIBRARY: &[HostRule] = &[
    rule(
        Text(lacks_library),
        NotLoaded,
        "there is nothing to load",
        "export it for this platform, or compile its sources",
    ),
    rule(Text(is_broken), RunFails, "the FMU does not run here", "see what `metafmu validate` says"),
];

/// FMPy 0.3.32 checks a description when it reads it, and so do all hosts that are built on it.
const FMPY: &[HostRule] = &[
    MISSING_FUNCTIONS,
    rule(
        Text(breaks_schema),
        NotLoaded,
        "FMPy refuses descriptions that break the schema",
        "validate=False where the host passes it on",
    ),
    rule(Text(repeats_names), NotLoaded, "FMPy refuses names that two variables have", REPAIR),
    rule(Variables(lacks_start), NotLoaded, "FMPy refuses variables that have no start value and need one", REPAIR),
    rule(Variables(is_calculated_with_start), NotLoaded, "FMPy refuses start values of calculated variables", REPAIR),
    rule(
        Variables(is_continuous_but_not_real),
        NotLoaded,
        "FMPy refuses continuous variables that are not real; it is the default of FMI 2.0",
        REPAIR,
    ),
    rule(
        Variables(combines_what_is_not_allowed),
        NotLoaded,
        "FMPy refuses this combination of causality, variability and initial",
        REPAIR,
    ),
    rule(Variables(uses_unknown_unit), NotLoaded, "FMPy refuses units that are not defined", REPAIR),
    rule(Variables(uses_unknown_display_unit), NotLoaded, "FMPy refuses display units that are not defined", REPAIR),
    rule(Variables(uses_unknown_type), NotLoaded, "FMPy refuses declared types that are not defined", REPAIR),
    rule(
        Whole(lacks_independent),
        NotLoaded,
        "FMPy refuses FMUs of FMI 3.0 without exactly one independent variable",
        REPAIR,
    ),
    rule(
        Text(repeats_references),
        NotLoaded,
        "FMPy refuses value references that two variables of FMI 3.0 have",
        REPAIR,
    ),
    rule(
        Text(has_backslashes),
        NotLoaded,
        "FMPy refuses backslashes in the archive",
        "pack it again with forward slashes",
    ),
    rule(Text(has_colons), NotLoaded, "FMPy refuses colons and leading slashes in the archive", "rename the files"),
];

/// Hosts that read all outputs as real numbers.
const REAL_OUTPUTS: &[HostRule] = &[
    rule(
        Variables(is_output_but_not_real),
        RunFails,
        "the host reads all outputs as scalar real numbers",
        "make these outputs local or real",
    ),
    rule(
        Variables(is_output_that_hits_a_real),
        WrongValues,
        "the host reads all outputs as real numbers, and shows the variable that has the same value reference",
        "make these outputs local or real",
    ),
];

/// Mistakes that the parser of FMI Library takes for fatal.
const FMI_LIBRARY: &[HostRule] = &[
    rule(
        Variables(uses_unknown_display_unit),
        NotLoaded,
        "FMI Library refuses display units that are not defined",
        REPAIR,
    ),
    WRONG_KINDS,
];

/// Mistakes that end fmi4c, the reader of ecos, OMSimulator and Hopsan.
const FMI4C: &[HostRule] = &[MISSING_FUNCTIONS, WRONG_KINDS];

const UNWIRED: HostRule = rule(
    Variables(is_input_that_starts_elsewhere),
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
                Variables(is_text_output),
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
                REAL_INPUTS,
                rule(
                    Variables(is_input_that_hits_a_real),
                    WrongValues,
                    "the host sets all inputs as real numbers, and so the variable that has the same value reference",
                    "make them parameters or real",
                ),
                rule(Whole(lacks_step_size), Limited, "there is no step size", "CoSimulationFMU(path, dt=...)"),
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
                    Variables(is_input_beyond_booleans),
                    NotLoaded,
                    "the host sets inputs as scalar real numbers",
                    "make them parameters or real",
                ),
                rule(
                    Variables(is_input_of_fmi_2_but_not_real),
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
                    Variables(is_port_with_text_start),
                    NotLoaded,
                    "the host takes every start value for a number",
                    "start=\"0\" or \"1\" of Booleans, or input_names=[...], output_names=[...] without these variables",
                ),
                rule(
                    Variables(is_text_output),
                    RunFails,
                    "texts are not recorded",
                    "output_names=[...] without these variables",
                ),
                rule(
                    Variables(is_whole_number_to_set),
                    RunFails,
                    "the host sets inputs and parameters as real numbers",
                    "input_names=[...] without these variables",
                ),
                rule(
                    Variables(is_array_to_set),
                    RunFails,
                    "the host does not convert start values of arrays",
                    "input_names=[...] without these variables",
                ),
                rule(
                    Variables(has_bytes_to_set),
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
                    Variables(has_exact_text_start),
                    NotLoaded,
                    "the host takes every exact start value for a number",
                    "start=\"0\" or \"1\" of Booleans",
                ),
                rule(
                    Variables(is_constant),
                    RunFails,
                    "the host sets constants as parameters",
                    "leave constants out of the description",
                ),
                rule(
                    Variables(is_computed_text),
                    RunFails,
                    "the host observes all variables, and texts are not recorded",
                    "simulate(..., observe=[...])",
                ),
                rule(
                    Variables(is_array),
                    RunFails,
                    "the host observes all variables, and takes scalars only",
                    "simulate(..., observe=[...])",
                ),
                rule(
                    Whole(offers_co_simulation),
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
                    Variables(is_enumerated_output),
                    Limited,
                    "these outputs cannot be logged or connected",
                    "leave them out of parameters_to_log",
                ),
                rule(
                    Variables(is_text_output),
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
                    Text(lacks_dependencies),
                    NotLoaded,
                    "the host needs the attribute `dependencies` of every unknown",
                    "write dependencies",
                ),
                rule(
                    Variables(is_input_that_starts_elsewhere),
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
                    Text(has_dots_in_its_identifier),
                    NotLoaded,
                    "the host looks for a library with `_` instead of dots",
                    "an identifier without dots",
                ),
                rule(
                    Variables(is_input_with_initial),
                    NotLoaded,
                    "the host refuses `initial` of inputs",
                    "leave it out: it is the default",
                ),
                rule(
                    Variables(is_odd_parameter),
                    NotLoaded,
                    "the host takes fixed and tunable parameters only",
                    REPAIR,
                ),
                rule(
                    Variables(is_called_time),
                    NotLoaded,
                    "the host takes `time` for the independent variable",
                    "rename the variable",
                ),
                rule(
                    Text(lacks_dependencies_in_fmi_3),
                    NotLoaded,
                    "the host needs the attribute `dependencies` of every unknown",
                    "write dependencies",
                ),
                WRONG_KINDS,
                rule(
                    Variables(is_structural_parameter),
                    NotLoaded,
                    "the host does not know structural parameters",
                    "fixed dimensions",
                ),
                rule(Variables(is_text_in_elements), NotLoaded, "the host does not read <Start>", "leave texts out"),
                rule(Variables(is_single_precision_to_set), NotLoaded, "the host does not know Float32", "Float64"),
                rule(
                    Text(is_packed_in_a_rare_way),
                    NotLoaded,
                    "the host unpacks stored and deflated files only",
                    "pack it again",
                ),
                rule(
                    Text(has_states_without_start),
                    Limited,
                    "DaeBuilder.start says 0 for states that the FMU initializes",
                    "set them to the values of another host",
                ),
                rule(Whole(has_events), Limited, "events are not handled", "only where no event happens"),
                rule(
                    Text(has_unlisted_parameters),
                    Limited,
                    "derivatives with respect to these parameters are zero, as no dependency lists them",
                    "list them, or FMI 2.0",
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
                    Variables(is_scalar_output_but_not_real),
                    RunFails,
                    "the host reads the outputs that are named as scalar real numbers",
                    "name real outputs only",
                ),
                arrays(Limited, "only scalars can be named"),
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
                    Text(is_of_late_dymola),
                    NotLoaded,
                    "these FMUs need the event iteration after the initialization, which the host leaves out",
                    "CoSimulationFMU",
                ),
                rule(
                    Whole(has_no_states),
                    RunFails,
                    "the host integrates states, and there are none",
                    "CoSimulationFMU",
                ),
                REAL_INPUTS,
            ],
        ],
    },
    Host {
        name: "libcosim",
        version: "0.11 (libcosimpy 0.0.6)",
        evidence: Evidence::Run,
        takes: &[CO_SIMULATION_2],
        rules: &[
            LIBRARY,
            FMI_LIBRARY,
            &[rule(Variables(is_enumeration), Limited, "enumerations are left out", "integers")],
        ],
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
                rule(Variables(is_clock), NotLoaded, "the host crashes at clocks", "an FMU without clocks"),
                rule(Variables(is_enumeration), Limited, "enumerations cannot be read or set", "integers"),
                arrays(Limited, "only one number of an array is read"),
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
                    Text(depends_on_reference_zero),
                    RunFails,
                    "the host takes the value reference 0 among dependencies for none",
                    "value references from 1",
                ),
                rule(Variables(is_array), RunFails, "the result of FMUs with arrays is empty", "scalars, or FMI 2.0"),
                text_ports("texts, bytes and clocks are left out"),
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
                    Whole(needs_another_program),
                    NotLoaded,
                    "the host runs no FMU that needs another program",
                    "a self-contained FMU",
                ),
                arrays(RunFails, "the host takes scalars only"),
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
                Variables(combines_what_is_not_allowed),
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
            rule(Text(lacks_windows), Limited, "there is nothing to load on Windows", "export it for x86_64-windows"),
            rule(
                Whole(is_of_fmi_3),
                Limited,
                "on Linux the host looks for FMI 3.0 in binaries/linux64",
                "FMI 2.0, or a copy of the library there",
            ),
            NO_TEXT_PORTS,
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
                    Text(has_names_that_become_one),
                    NotLoaded,
                    "dots and brackets become `_`, and names collide",
                    "other names",
                ),
                arrays(Limited, "arrays are left out"),
                text_ports("bytes and clocks are left out"),
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
                rule(
                    Variables(is_structural_parameter),
                    NotLoaded,
                    "the host reads fixed dimensions only",
                    "fixed dimensions",
                ),
                arrays(Limited, "start values of arrays are not read"),
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
            &[rule(
                Whole(cannot_put_its_state_back),
                Limited,
                "implicit coupling puts states back",
                "explicit coupling",
            )],
        ],
    },
    Host {
        name: "Unity-FMI-Addon",
        version: "of 2018",
        evidence: Evidence::Read,
        takes: &[CO_SIMULATION_2],
        rules: &[&[rule(
            Text(lacks_windows),
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
                NO_TEXT_PORTS,
                arrays(Limited, "arrays have no port"),
                rule(
                    Whole(is_of_fmi_3),
                    Limited,
                    "the host gives FMUs of FMI 3.0 a stop time of 10 s",
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
        rules: &[&[rule(
            Variables(has_dots_or_brackets),
            NotLoaded,
            "the host refuses dots and brackets in names",
            "flat names",
        )]],
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
                    Whole(offers_both_interfaces),
                    NotLoaded,
                    "the host refuses FMUs with both interfaces",
                    "an FMU for co-simulation only",
                ),
                rule(Whole(lacks_step_size), Limited, "there is no step size", "give one to the adapter"),
                rule(
                    Variables(is_output_but_not_real),
                    RunFails,
                    "the host reads all outputs as real numbers",
                    "make these outputs local or real",
                ),
            ],
        ],
    },
];

use super::{draft::PLACEHOLDER, *};
use toml::de::DeTable;

pub const GOOD: &str = include_str!("../../../examples/paper/single-pendulum.toml");

fn problems(text: &str) -> Vec<String> {
    match Study::parse(text, Path::new("study.toml")) {
        Ok(_) => Vec::new(),
        Err(error) => error.to_string().lines().map(str::to_owned).collect(),
    }
}

/// The one message for the good study with one piece of its text replaced.
fn message(from: &str, to: &str) -> String {
    assert!(GOOD.contains(from), "{from} is not in the example");
    let messages = problems(&GOOD.replacen(from, to, 1));
    assert_eq!(messages.len(), 1, "{messages:#?}");
    messages[0].clone()
}

/// The good study with another plan.
fn sobol(runs: usize) -> String {
    GOOD.replacen("\"mesh\"", "\"sobol\"", 1).replacen("levels = 11", &format!("runs = {runs}"), 1)
}

#[test]
fn the_example_is_the_papers_case() {
    let study = Study::parse(GOOD, Path::new("single-pendulum.toml")).unwrap();
    assert_eq!(study.parameters.keys().collect::<Vec<_>>(), ["L", "c", "thetad0"]);
    assert_eq!(study.outputs.keys().collect::<Vec<_>>(), ["theta", "thetad", "thetadd"]);
    assert_eq!(study.train_runs(), 1331);
    assert_eq!(study.network.hidden, [128, 128]);
}

#[test]
fn only_what_decides_the_surrogate_changes_the_digest() {
    let parse = |text: &str| Study::parse(text, Path::new("s.toml")).unwrap();
    let study = parse(GOOD);
    assert_eq!(study.digest(), parse(&format!("# a comment\n{GOOD}")).digest());
    assert_eq!(study.digest(), parse(&GOOD.replacen("license = ", "author = \"me\"\nlicense = ", 1)).digest());
    let other = parse(&GOOD.replacen("epochs = ", "epochs = 1", 1));
    assert_ne!(study.digest(), other.digest());
    assert_eq!(study.sampling_digest(), other.sampling_digest());
    assert_eq!(study.digest(), parse(&GOOD.replacen("fmi = \"2\"", "fmi = \"both\"", 1)).digest());
    assert_ne!(study.digest(), parse(&GOOD.replacen("\"double\"", "\"single\"", 1)).digest());
}

#[test]
fn every_mistake_is_located_by_line_and_key() {
    let line = |needle: &str| GOOD.lines().position(|line| line.starts_with(needle)).unwrap() + 1;
    for (from, to, needle, key, says) in [
        (
            "[network]",
            "[network]\nnods = 3",
            "[network]",
            "network.nods",
            "unknown key `nods`, expected one of structure, hidden",
        ),
        ("stop = 2.0", "stop = \"2\"", "stop", "time.stop", "expected"),
        ("stop = 2.0", "stp = 2.0", "stop", "time.stp", "did you mean `stop`?"),
        ("step = 0.01", "stp = 0.01", "step", "time.stp", "did you mean `step`?"),
        ("stop = 2.0", "stop = -2.0", "stop", "time.stop", "expected a positive number"),
        ("step = 0.01", "step = 0.03", "step", "time.step", "does not divide"),
        ("min = 0.1,", "min = 0.3,", "L = ", "parameters.L", "min 0.3 is not below max 0.2"),
        ("min = 0.1,", "min = nan,", "L = ", "parameters.L", "not finite"),
        ("\nc = ", "\n\" c\" = ", "c = ", "parameters. c", "` c` is not a valid name of a variable"),
        ("\nc = ", "\nin_domain = ", "c = ", "parameters.in_domain", "that every FMU of metafmu has"),
        ("\nc = ", "\ntime = ", "c = ", "parameters.time", "independent variable"),
        ("theta = {", "c = {", "theta = ", "outputs.c", "parameter already"),
        ("theta = {", "L = 3 #", "theta = ", "outputs.L", "expected"),
        ("levels = 11", "levels = 1", "levels", "parameters.L.levels", "at least 2"),
        ("method = \"mesh\"", "method = \"grid\"", "method", "sampling.method", "\"grid\", expected one of \"mesh\""),
        ("levels = 11", "levels = 11\nruns = 5", "levels", "sampling.runs", "a mesh has `levels`"),
        ("levels = 11", "levels = 11\nfaces = 0.1", "levels", "sampling.faces", "a mesh has its ends anyway"),
        ("levels = 11", "levels = 11\nfaces = 0.6", "levels", "sampling.faces", "a mesh has its ends anyway"),
        ("step = 0.01", "step = 0.01\nmargin = 5", "step = ", "time.margin", "5, expected a share from 0 to 1"),
        ("epochs = ", "epochs = 4\nenough = 1e-6 # ", "epochs", "training.enough", "belongs to the schedule"),
        ("levels = 11", "levels = 11\nfile = \"p.csv\"", "levels", "sampling.file", "belongs to the method \"list\""),
        ("method = \"mesh\"", "method = \"halton\"", "levels", "sampling.levels", "belongs to the method \"mesh\""),
        ("fmi = \"2\"", "fmi = \"4\"", "fmi", "export.fmi", "\"4\", expected one of \"2\", \"3\", \"both\""),
        ("\"double\"", "\"half\"", "precision", "export.precision", "\"half\", expected"),
        (
            "[sampling]",
            "[arrays]\nq = [\"theta\", \"omega\"]\n[sampling]",
            "[sampling]",
            "arrays.q",
            "`omega` is not an output",
        ),
        ("epochs = ", "epochs = -", "epochs", "training.epochs", "expected"),
        ("[network]", "[bounds]\ncoverage = 95\n[network]", "[network]", "bounds.coverage", "between 0 and 1"),
        ("[network]", "[bounds]\nruns = 18\n[network]", "[network]", "bounds.runs", "at least 19"),
        ("theta = {", "in_domain = {", "theta = ", "outputs.in_domain", "that every FMU of metafmu has"),
        ("[network]", "[accept]\nr2 = 1.5\n[network]", "[network]", "accept.r2", "a number below 1"),
        ("[network]", "[accept]\nr3 = 0.5\n[network]", "[network]", "accept.r3", "unknown key"),
    ] {
        let messages = problems(&GOOD.replacen(from, to, 1));
        let found = messages.iter().find(|message| message.contains(&format!(": {key}: ")) && message.contains(says));
        let found = found.unwrap_or_else(|| panic!("{to}: no `{key}` with `{says}` in {messages:#?}"));
        let expected = line(needle) + usize::from(to.contains('\n') && from != "\nc = ");
        // a mistake in a value that only the defaults of `levels` explain is placed at the parameter
        if key != "parameters.L.levels" {
            assert!(found.starts_with(&format!("study.toml:{expected}:")), "{to}: not line {expected}: {found}");
        }
    }
}

#[test]
fn nominal_and_periodic_parameters_are_checked_and_count_for_the_digest() {
    let l = "L = { min = 0.1, max = 0.2,";
    for (to, says) in [
        ("L = { values = [],", "parameters.L: no `values`, expected at least 2"),
        ("L = { values = [0.1],", "parameters.L: 1 value, expected at least 2"),
        ("L = { values = [0.1, 0.2, 0.1],", "parameters.L: value 0.1 is duplicated"),
        ("L = { values = [0.1, inf],", "parameters.L: value inf is not finite"),
        ("L = { values = [0.1, nan],", "parameters.L: value NaN is not finite"),
        ("L = { values = [0.1, 0.2], min = 0.1,", "parameters.L: `values` exclude `min`, `max`, `levels` and"),
        ("L = { values = [0.1, 0.2], levels = 2,", "parameters.L: `values` exclude `min`, `max`, `levels` and"),
        ("L = { values = [0.1, 0.2], periodic = true,", "parameters.L: `values` exclude `min`, `max`, `levels`"),
        ("L = { max = 0.2,", "parameters.L: `min` is missing"),
        ("L = { min = 0.2,", "parameters.L: `max` is missing"),
        ("L = { periodic = true,", "parameters.L: expected `min` and `max`, or `values`"),
        ("L = { min = 0.1, max = 0.2, cyclic = true,", "parameters.L.cyclic: unknown key `cyclic`, expected"),
        ("L = { values = [\"a\"],", "parameters.L.values[0]: \"a\", expected a number"),
    ] {
        let found = message(l, to);
        assert!(found.contains(says), "{to}: {found}");
        assert_eq!(found.split(':').nth(1), message(l, "L = { min = 0.3, max = 0.2,").split(':').nth(1), "{found}");
    }
    let nominal = |text: &str| text.replacen("min = 0.0, max = 0.15", "values = [0, 1]", 1);
    let all = nominal(GOOD).replacen("min = 0.0, max = 5.0", "values = [0, 1]", 1);
    assert_eq!(problems(&all), Vec::<String>::new());
    let all = problems(&all.replacen("min = 0.1, max = 0.2", "values = [0.1, 0.2]", 1));
    assert!(all.len() == 1 && all[0].contains("parameters: every parameter has `values`"), "{all:?}");
    let digest = |text: &str| Study::parse(text, Path::new("s.toml")).unwrap().sampling_digest();
    let of = [GOOD, &nominal(GOOD), &GOOD.replacen("max = 5.0", "max = 5.0, periodic = true", 1)].map(digest);
    assert!(of[0] != of[1] && of[1] != of[2] && of[0] != of[2]);
    assert_eq!(of[0], digest(&GOOD.replacen("max = 5.0", "max = 5.0, periodic = false", 1)));
}

#[test]
fn malformed_toml_and_duplicate_keys_are_located() {
    assert!(message("[time]", "[time").starts_with("study.toml:"));
    assert!(message("\nc = ", "\nL = ").contains("duplicate key"));
}

#[test]
fn options_of_network_and_training_that_make_no_sense_are_found_at_load_all_at_once() {
    let (head, _) = GOOD.split_once("[network]").unwrap();
    let wrong = [
        ("batch = 1", "at least 2 rows with `batch_norm`"),
        ("batch_norm = true", ""),
        ("clip_norm = -1.0", "0 or a positive number"),
        ("dropout = 2", "below 1"),
        ("epochs = 1000000000", "1 to 1000000"),
        ("huber_delta = 0.5", "belongs to the loss \"huber\""),
        ("l1 = inf", "0 or a positive number"),
        ("momentum = 1.0", "below 1"),
        ("optimizer = \"sgd\"", ""),
        ("output_weights = [1.0]", "1 weights, expected one for each output"),
        ("refresh = 5", "belongs to the optimizer \"soap\""),
        ("beta2 = 0.9", "\"sgd\" has `momentum` only"),
        ("validation = 1.0", "between 0 and 1"),
        ("warm_up = -0.1", "below 1"),
        ("weight_decay = 0.1", "belongs to the optimizers \"adamw\" and \"soap\""),
    ];
    let training: String = wrong.iter().map(|(line, _)| format!("{line}\n")).collect();
    let found = problems(&format!("{head}[training]\n{training}"));
    let first = head.lines().count() + 2;
    for (index, (line, says)) in wrong.iter().enumerate().filter(|(_, (_, says))| !says.is_empty()) {
        let place = format!("study.toml:{}: training.{}: ", first + index, line.split(' ').next().unwrap());
        assert!(
            found.iter().any(|found| found.starts_with(&place) && found.contains(says)),
            "{place}{says}: {found:#?}"
        );
    }
    assert_eq!(found.len(), wrong.len() - 2, "{found:#?}");
    let of_layers = problems(&format!("{head}[network]\nhidden = []\n[training]\ndropout = 0.1\nbatch_norm = true\n"));
    assert_eq!(of_layers.len(), 2, "{of_layers:#?}");
}

#[test]
fn counts_that_no_machine_can_hold_are_refused_with_their_limit() {
    let huge = "1000000000000";
    for (from, to, says) in [
        (
            "test_runs = 200",
            format!("test_runs = {huge}"),
            "sampling.test_runs: 1000000000000 runs, expected at most 10000000",
        ),
        (
            "levels = 11",
            format!("levels = {huge}"),
            "sampling.levels: more runs than can be counted, expected at most 10000000",
        ),
        (
            "[network]",
            format!("[bounds]\nruns = {huge}\n[network]"),
            "bounds.runs: 1000000000000 runs, expected at most",
        ),
        (
            "hidden = [128, 128]",
            "hidden = [16384, 16384]".into(),
            "network.hidden: 2.686e8 weights and biases, expected at most",
        ),
        (
            "hidden = [128, 128]",
            "hidden = [1024, 1024]\nstructure = \"fixed\"".into(),
            "network.hidden: 2.124e8 weights and biases of 201 networks, expected at most 100 million",
        ),
    ] {
        let found = message(from, &to);
        assert!(found.contains(says), "{says} is not in {found}");
    }
    for (runs, says) in [
        (1_000_000_000_000, "sampling.runs: 1000000000000 runs, expected at most 10000000"),
        (9_000_000, "sampling: 1.809e9 rows of all runs, expected at most a billion"),
    ] {
        let found = problems(&sobol(runs));
        assert!(found.len() == 1 && found[0].contains(says), "{found:#?}");
    }
    let name = message("name = \"single-pendulum\"", &format!("name = \"{}\"", "n".repeat(300)));
    assert!(name.contains("name: 300 characters, expected at most 100"), "{name}");
}

#[test]
fn a_target_needs_enough_held_out_runs() {
    let of = |runs: usize| problems(&(sobol(runs) + "[target]\nr2 = 0.9\nruns = 10\nmax_runs = 1000\n"));
    // the example holds out a twentieth
    assert_eq!(of(200), Vec::<String>::new());
    let few = of(60);
    assert_eq!(few.len(), 1, "{few:#?}");
    let expected = "target: 3 of 60 runs are held out to judge it, expected at least 10: set `training.validation` of at \
                    least 0.17, or more `sampling.runs` (200 runs with `training.validation = 0.05`)";
    assert!(few[0].contains(expected), "{}", few[0]);
    let many = GOOD.to_owned() + "[target]\nr2 = 0.9\nruns = 1000000\nmax_runs = 2000\n";
    let many = problems(&many);
    assert!(many.len() == 1 && many[0].contains("target.runs: 1000000 runs, expected 1 to 100000"), "{many:#?}");
}

#[test]
fn thousands_of_mistakes_take_no_longer_than_reading_them() {
    let outputs: String = (0..20_000).map(|index| format!("\" y{index}\" = {{}}\n")).collect();
    let text = GOOD.replacen("[outputs]", &format!("[outputs]\n{outputs}"), 1);
    let begin = std::time::Instant::now();
    let found = problems(&text);
    assert_eq!(found.len(), 20_000);
    let line = text.lines().position(|line| line.starts_with("\" y19999\"")).unwrap() + 1;
    assert!(found[19_999].starts_with(&format!("study.toml:{line}: outputs. y19999: ")), "{}", found[19_999]);
    assert!(begin.elapsed().as_secs() < 20, "{:?}", begin.elapsed());
}

/// A section with a mistake in its structure is not judged further, the others are; nothing is said that follows from a mistake.
#[test]
fn mistakes_of_all_kinds_are_told_at_once_and_their_consequences_are_not() {
    let text = GOOD
        .replacen("stop = 2.0", "stop = \"2\"", 1)
        .replacen("levels = 11", "level = 11", 1)
        .replacen("min = 0.1,", "min = 0.3,", 1)
        .replacen("hidden = [128, 128]", "hidden = [0]\nnodes = 3", 1)
        .replacen("activation = \"relu\"", "activation = 1", 1);
    let found = problems(&text);
    let keys: Vec<&str> = found.iter().map(|line| line.split(": ").nth(1).unwrap()).collect();
    assert_eq!(
        keys,
        ["time.stop", "parameters.L", "sampling.level", "network.nodes", "network.activation"],
        "{found:#?}"
    );
    let missing = problems(&GOOD.replacen("[time]", "[tyme]", 1));
    let says = ["`time` is missing", "tyme: unknown key `tyme`, expected one of name, description, seed"];
    assert!(missing.len() == 2 && missing.iter().zip(says).all(|(line, says)| line.contains(says)), "{missing:#?}");
}

#[test]
fn the_default_of_every_section_and_the_placeholder_are_valid() {
    let schema = json_schema();
    assert!(DeTable::parse(PLACEHOLDER).is_ok());
    let root = Origin::new(Path::new("p"), PLACEHOLDER);
    let document = root.parse().unwrap();
    let (problems, _) = root.structure(document.get_ref(), schema, |_, _| None);
    assert!(problems.is_empty(), "{problems:?}");
    let study: Study = root.deserialize(document).unwrap();
    assert!(study.network.problems().is_empty() && study.training.problems().is_empty());
    assert!(study.accept.problems().is_empty() && BoundsOptions::default().problems().is_empty());
}

#[test]
fn every_problem_is_listed_not_only_the_first() {
    let text = GOOD.replacen("stop = 2.0", "stop = 0.0", 1).replacen("min = 0.1,", "min = 0.3,", 1);
    assert!(problems(&text).len() >= 2);
}

/// Keys of the schema that have limits, and the part of it with the limits: of a list that of its elements.
fn limited<'a>(schema: &'a serde_json::Value, key: &str, found: &mut Vec<(String, bool, &'a serde_json::Value)>) {
    let numbers = schema.get("items").unwrap_or(schema);
    if LIMITS.iter().any(|limit| numbers.get(limit).is_some()) {
        found.push((key.to_owned(), schema.get("items").is_some(), numbers));
    }
    for (name, inner) in schema.get("properties").and_then(serde_json::Value::as_object).into_iter().flatten() {
        let separator = if key.is_empty() { "" } else { "." };
        limited(inner, &format!("{key}{separator}{name}"), found);
    }
    if let (Some(others), "parameters") = (schema.get("additionalProperties"), key) {
        limited(others, "parameters.L", found);
    }
}

const LIMITS: [&str; 4] = ["minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"];

#[test]
fn the_schemas_limits_are_those_of_the_checks() {
    let given = "sampling = { method = 'sobol', runs = 200 }
                 training = { loss = 'huber' }
                 target = { r2 = 0.9, runs = 1, max_runs = 300 }
                 bounds = { coverage = 0.5 }
                 search = { trials = 2, space = { seed = [1, 2] } }";
    let mut given: toml::Table = given.parse().unwrap();
    for (key, value) in GOOD.parse::<toml::Table>().unwrap() {
        given.entry(key).or_insert(value);
    }
    let refuses = |key: &str, value: toml::Value| {
        let mut study = given.clone();
        let (section, name) = key.rsplit_once('.').unwrap_or_default();
        let also = match (section, name) {
            ("source", "step" | "retries" | "memory_limit" | "repeats") => "source = { fmu = 'none.fmu' }",
            ("sampling", "states") | ("dynamics", "solver_step") => {
                "structure = 'dynamics'\nsource = { fmu = 'none.fmu' }"
            }
            ("sampling", "train_stop") => "structure = 'dynamics'\nsource = { table = 'none.csv' }",
            ("baselines.knn", "rows") => "baselines = { knn = { neighbors = 1 } }",
            ("compliant", "dissipation") => "compliant = { velocities = ['v'] }",
            // of more parameters there are too many terms
            (_, "degree") => "parameters = { L = { min = 0.1, max = 0.2 } }",
            (_, "levels") => "sampling = { method = 'mesh', levels = 3 }",
            _ => "",
        };
        study.extend(also.parse::<toml::Table>().unwrap());
        set(&mut study, key, value);
        // levels that a parameter has from the plan are told as its own
        let told = if name == "levels" { "levels: ".into() } else { format!(": {key}: ") };
        problems(&study.to_string()).iter().any(|line| line.contains(&told) || line.contains(&format!(": {key}[0]: ")))
    };
    let mut keys = Vec::new();
    limited(json_schema(), "", &mut keys);
    for key in ["training.batch", "training.dropout", "time.stop", "network.hidden", "baselines.ridge.alpha"] {
        assert!(keys.iter().any(|(known, ..)| known == key), "{key}");
    }
    let mut wrong = Vec::new();
    for (key, is_list, schema) in keys {
        for limit in LIMITS {
            let Some(at) = schema.get(limit).and_then(serde_json::Value::as_f64) else { continue };
            // at least the plan's runs
            if (key.as_str(), limit) == ("target.max_runs", "minimum") {
                continue;
            }
            let is_whole = schema["type"] == "integer";
            let further = if limit.ends_with("inimum") { -1.0 } else { 1.0 };
            let little = if is_whole {
                1.0
            } else if at == 0.0 {
                1e-6
            } else {
                1e-3 * at
            };
            let value = |number: f64| {
                let number = if is_whole { toml::Value::Integer(number as i64) } else { toml::Value::Float(number) };
                // the example has three outputs
                if is_list { vec![number, 1.into(), 1.into()].into() } else { number }
            };
            let exclusive = limit.starts_with("exclusive");
            let (good, bad) = if exclusive { (at - further * little, at) } else { (at, at + further * little) };
            if !refuses(&key, value(bad)) {
                wrong.push(format!("{key} = {bad} is beyond its {limit} of {at}"));
            }
            if refuses(&key, value(good)) {
                wrong.push(format!("{key} = {good} is within its {limit} of {at}"));
            }
        }
    }
    assert_eq!(wrong, [""; 0]);
}

#[test]
fn names_of_coordinates_need_no_quotes() {
    let crane = include_str!("../../../examples/dynamics/crane-study.toml");
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/dynamics/s.toml"));
    let parse = |text: &str| Study::parse(text, path);
    let quoted = parse(crane).unwrap();
    let bare = crane.replace("\"rail.position\"", "rail.position").replace("\"rope.angle\"", "rope.angle");
    assert_ne!(bare, crane);
    assert_eq!(parse(&bare).unwrap().states, quoted.states);
    assert_eq!(parse(&bare).unwrap().digest(), quoted.digest());
    // a mistake has its line
    let error = parse(&bare.replace("min = -5.0, max = 5.0", "min = 5.0, max = -5.0")).unwrap_err().to_string();
    let line = bare.lines().position(|line| line.starts_with("rail.position")).unwrap() + 1;
    assert!(error.contains(&format!("s.toml:{line}: states.rail.position: range is empty")), "{error}");
}

/// A study of a static map of a table that exists.
fn static_study(more: &str) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("t.csv"), "a,y\n1,2\n").unwrap();
    let text = format!("name = 's'\nstructure = 'static'\nsource = {{ table = 't.csv' }}\noutputs.y = {{}}\n{more}");
    let text = if text.contains("inputs") { text } else { text + "\n[inputs]\na = {}\n" };
    match Study::parse(&text, &folder.path().join("study.toml")) {
        Ok(study) => {
            assert!(study.runs().are_rows && !study.runs().have_memory, "{text}");
            Vec::new()
        }
        Err(error) => {
            error.to_string().lines().map(|line| line.split(": ").skip(1).collect::<Vec<_>>().join(": ")).collect()
        }
    }
}

#[test]
fn a_static_map_has_inputs_and_outputs_and_no_section_of_runs() {
    assert_eq!(static_study(""), [""; 0]);
    assert_eq!(static_study("static.model = 'gaussian-process'\nbounds = {}\naccept.r2 = 0.5"), [""; 0]);
    assert_eq!(static_study("static = { model = 'gaussian-process', std = true }\ninputs.y_stds = {}"), [""; 0]);
    for section in ["time", "parameters", "states", "dynamics", "discrete", "sampling", "target", "baselines", "search"]
    {
        let found = static_study(&format!("[{section}]"));
        assert!(found.iter().any(|line| line.starts_with(&format!("{section}: belongs to "))), "{section}: {found:?}");
    }
    let all = static_study(
        "time = { stop = 1, step = 1 }\nsampling.test_runs = 3\nnetwork.structure = 'fixed'\nexport.precision = 'single'\nbounds.runs = 50",
    );
    let keys: Vec<&str> = all.iter().filter_map(|line| line.split(':').next()).collect();
    assert_eq!(keys, ["time", "sampling", "network.structure", "export.precision", "bounds.runs"]);
    for (more, says) in [
        ("inputs = {}", "inputs: no input"),
        ("inputs.a = { bandwidth = 1 }", "inputs.a.bandwidth: belongs to sources that are simulated"),
        ("inputs.a = { min = 2, max = 1 }", "inputs.a: from 2 to 1"),
        ("inputs.y = {}", "inputs.y: `y` is a parameter or output already"),
        ("static.model = 'knn'", "static.model: \"knn\", expected one of \"network\", \"linear\""),
        ("network.hidden = [16384, 16384]", "network.hidden: 2.685e8 weights"),
        ("static = { model = 'network', std = true }", "static.std: network has no predicted standard deviation"),
        (
            "static.std = true\ninputs.y_std = {}",
            "inputs.y_std: `y_std` is the name of the predicted standard deviation of `y`",
        ),
    ] {
        let found = static_study(more);
        assert!(found.len() == 1 && found[0].starts_with(says), "{more}: {found:?}");
    }
    assert!(problems(&GOOD.replacen("[time]", "[times]", 1)).iter().any(|line| line.ends_with("`time` is missing")));
    let found = message("[sampling]", "[static]\nmodel = \"linear\"\n[sampling]");
    assert!(found.ends_with("static: belongs to the structure \"static\""), "{found}");
}

#[test]
fn epochs_of_a_static_map_follow_from_the_rows_unless_given() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("t.csv"), "a,y\n1,2\n").unwrap();
    let study = |more: &str| {
        let text = "name = 's'\nstructure = 'static'\nsource = { table = 't.csv' }\ninputs.a = {}\noutputs.y = {}\n";
        Study::parse(&format!("{text}{more}"), &folder.path().join("study.toml")).unwrap()
    };
    let usual = study("");
    assert_eq!((usual.network.hidden.as_slice(), usual.training.schedule), (&[64, 64][..], Schedule::Cosine));
    assert_eq!([200, 5000, 1_000_000].map(|rows| usual.training_on(rows).epochs), [2000, 150, 150]);
    let given = study("[training]\nepochs = 150\nbatch = 10");
    assert_eq!((given.training_on(200).epochs, given.training.batch), (150, 10));
    assert_ne!(usual.digest(), given.digest());
    assert_ne!(usual.digest(), study("static.model = 'linear'").digest());
    assert_eq!(usual.digest(), study("# a comment").digest());
}

#[test]
fn actuator_states_of_a_mechanism_are_states_of_a_study() {
    let folder = tempfile::tempdir().unwrap();
    let mechanism = r#"
        inputs.u = { min = -5, max = 5 }
        states = { current = { rate = "u - current" }, integral = { rate = "u", start = 0.5 } }
        bodies.a = { mass = 1, inertia = 1 }
        joints.p = { type = "revolute", between = ["ground", "a"] }
        actuators.m = { coordinate = "p.angle", effort = "current + integral" }
        outputs = { angle = { measure = "p.angle" }, current = { measure = "current" } }
    "#;
    std::fs::write(folder.path().join("m.toml"), mechanism).unwrap();
    let text = r#"
        name = "s"
        structure = "dynamics"
        source.mechanism = "m.toml"
        time = { stop = 1, step = 0.1 }
        outputs.angle = {}
        [states]
        integral = { min = -2, max = 3 }
        current = { start = [0, 1] }
        "p.angle" = { min = -1, max = 1 }
    "#;
    let parse = |text: &str| Study::parse(text, &folder.path().join("s.toml"));
    let study = parse(text).unwrap();
    // coordinates, velocities, then the order of the mechanism file
    let starts: Vec<&String> = study.starts().keys().collect();
    assert_eq!(starts, ["p.angle_start", "p.angular_velocity_start", "current_start", "integral_start"]);
    let start = &study.starts()["integral_start"];
    assert_eq!([start.min, start.max], [0.0, 1.0]);
    let kept = r#"integral = { min = -2, max = 3 }"#;
    for (from, to, says) in [
        (
            "\"p.angle\" = { min = -1, max = 1 }",
            "",
            "states: no coordinate, expected a coordinate for each degree of freedom",
        ),
        ("current =", "curent =", "did you mean `current`?"),
        ("start = [0, 1]", "min = 1", "states.current: expected `min` and `max`"),
        ("start = [0, 1]", "", "states.current: expected `start`, or `min` and `max`"),
        ("start = [0, 1]", "start = [1, 0]", "states.current.start: [1, 0]"),
        ("start = [0, 1]", "start = [0, 1], velocity = [0, 1]", "states.current.velocity: belongs to coordinates"),
        (kept, "integral = { min = -2, max = 3, start = [0, 5] }", "states.integral.start: from 0 to 5"),
    ] {
        assert!(text.contains(from), "{from}");
        let message = parse(&text.replace(from, to)).unwrap_err().to_string();
        assert!(message.contains(says), "{message}\n{says}");
    }
}

#[test]
fn every_structure_of_the_schema_is_known_by_its_name() {
    let schema = serde_json::to_value(schemars::schema_for!(StudyStructure)).unwrap();
    let names: Vec<&str> =
        schema["oneOf"].as_array().unwrap().iter().map(|one| one["const"].as_str().unwrap()).collect();
    assert!(
        names.len() >= 5 && names.iter().all(|name| StudyStructure::named(name).is_some_and(|of| of.name() == *name))
    );
}

use super::*;
use crate::{
    Error,
    fmi::{FmiVersion, Platform, validate::Finding},
};
use metafmu_testing::{
    changed_fmu, entry, fmu_described_as, fmu_of, fmu_of_described_as, fmu_with_arrays, fmu_with_bounds,
    fmu_with_encodings, fmu_with_input, fmu_with_states,
};
use std::path::{Path, PathBuf};

fn problems(fmu: PathBuf) -> Vec<String> {
    validate(fmu).unwrap().problems.iter().map(Finding::to_string).collect()
}

#[test]
fn our_own_fmu_has_no_problem_and_nothing_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let complete = Report { was_run: true, ..Report::default() };
    for version in [FmiVersion::V2, FmiVersion::V3] {
        assert_eq!(validate(fmu_of(folder.path(), version)).unwrap(), complete);
        assert_eq!(validate(fmu_with_input(folder.path(), version)).unwrap(), complete);
        assert_eq!(validate(fmu_with_arrays(folder.path(), version)).unwrap(), complete);
        assert_eq!(validate(fmu_with_bounds(folder.path(), version)).unwrap(), complete);
        assert_eq!(validate(fmu_with_states(folder.path(), version)).unwrap(), complete);
    }
}

#[test]
fn derivatives_by_a_parameter_that_has_no_range_are_left_out_and_those_by_the_others_are_not() {
    let folder = tempfile::tempdir().unwrap();
    for version in [FmiVersion::V2, FmiVersion::V3] {
        let report = validate(fmu_with_encodings(folder.path(), version)).unwrap();
        assert_eq!(report.problems, []);
        let left_out = "derivatives by \"length\": it has the trained values 0.14, 0.1, 0.2 only, and no range";
        assert_eq!(report.not_checked, [left_out]);
    }
}

#[test]
fn what_is_no_archive_is_an_error() {
    assert!(matches!(validate("/no/such.fmu"), Err(Error::Io { .. })));
    let no_archive = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/lib.rs");
    assert!(matches!(validate(no_archive), Err(Error::Archive { .. })));
}

#[test]
fn a_description_that_cannot_be_read_is_the_only_finding() {
    let folder = tempfile::tempdir().unwrap();
    let newer = fmu_described_as(folder.path(), |text| text.replace("fmiVersion=\"2.0\"", "fmiVersion=\"4.0\""));
    let report = validate(newer).unwrap();
    assert_eq!(
        report.problems[0].to_string(),
        "modelDescription.xml, line 2: fmiVersion is \"4.0\": only FMI 2.0 and 3.0 are supported"
    );
    assert_eq!(report.not_checked, ["the binary and what it computes: modelDescription.xml cannot be read"]);
    let none = changed_fmu(folder.path(), |entries| drop(entries.remove(0)));
    assert_eq!(problems(none), ["archive: there is no `modelDescription.xml`"]);
}

#[test]
fn an_fmu_without_a_binary_is_wrong_and_one_for_another_platform_is_not_checked() {
    let folder = tempfile::tempdir().unwrap();
    let expected = Platform::CURRENT.binary(FmiVersion::V2, "example");
    let without = changed_fmu(folder.path(), |entries| entries.retain(|(name, _)| !name.starts_with("binaries/")));
    assert_eq!(problems(without), [format!("binary: there is no binary for any platform, expected `{expected}`")]);
    let other = changed_fmu(folder.path(), |entries| {
        entry(entries, "binaries/").0 = "binaries/amiga/example.so".into();
    });
    let report = validate(other).unwrap();
    assert_eq!(report.problems, []);
    assert!(report.not_checked.iter().any(|reason| reason.ends_with("the FMU has amiga")), "{report}");
    assert!(!report.was_run, "{report}");
}

#[test]
fn problems_of_behavior_are_found_by_either_version() {
    let folder = tempfile::tempdir().unwrap();
    for version in [FmiVersion::V2, FmiVersion::V3] {
        let missing = fmu_of_described_as(folder.path(), version, |text| {
            text.replacen("modelIdentifier=\"example\"", "modelIdentifier=\"other\"", 1)
        });
        let found = validate(missing).unwrap();
        assert!(found.not_checked[0].contains("other."), "{found}");
        let token = fmu_of_described_as(folder.path(), version, |text| text.replacen("=\"{", "=\"{0", 1));
        let found = problems(token);
        assert!(found.iter().any(|problem| problem.contains("returned no instance")), "{found:?}");
    }
}

#[test]
fn a_changed_reference_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let found = problems(changed_fmu(folder.path(), |entries| {
        let text = &mut entry(entries, "extra/org.metafmu/reference_result.csv").1;
        *text = String::from_utf8_lossy(text).replacen("\n0,", "\n0,1", 1).into_bytes();
    }));
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found[0].starts_with("behavior: co-simulation, the reference run: \"angle\" is "), "{found:?}");
}

#[test]
fn a_damaged_binary_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let damaged = changed_fmu(folder.path(), |entries| entry(entries, "binaries/").1.truncate(1000));
    assert!(problems(damaged)[0].contains("is cut short: 1000 bytes"));
}

#[test]
fn variables_of_the_domain_are_checked_by_their_names() {
    let folder = tempfile::tempdir().unwrap();
    for version in FmiVersion::ALL {
        let found = problems(fmu_of_described_as(folder.path(), version, |text| {
            let changed = text.replace(
                "name=\"domain_distance\" valueReference=\"8\"",
                "name=\"domain_distance\" valueReference=\"5\"",
            );
            let changed =
                changed.replace("name=\"velocity\" valueReference=\"5\"", "name=\"velocity\" valueReference=\"8\"");
            assert_ne!(changed, text);
            changed
        }));
        assert!(found.iter().any(|problem| problem.contains("domain_policy 0: domain_distance is")), "{found:?}");
    }
}

#[test]
fn a_token_that_is_not_that_of_the_model_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let found = problems(fmu_described_as(folder.path(), |text| text.replace("guid=\"{", "guid=\"{0")));
    assert!(
        found.iter().any(|problem| problem.starts_with("surrogate: the token in modelDescription.xml is ")),
        "{found:?}"
    );
    assert!(found.iter().any(|problem| problem.contains("fmi2Instantiate returned no instance")), "{found:?}");
}

#[test]
fn a_changed_weight_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let found = problems(changed_fmu(folder.path(), |entries| {
        let model = &mut entry(entries, MODEL_FILE).1;
        let place = model.len() - 4;
        model[place] ^= 1;
    }));
    assert!(found[0].contains("the file is damaged"), "{found:?}");
    assert!(found.iter().any(|problem| problem.contains("fmi2Instantiate returned no instance")), "{found:?}");
}

#[test]
fn outputs_that_are_not_those_predicted_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let swapped = fmu_described_as(folder.path(), |text| {
        let text = text.replace("valueReference=\"4\"", "valueReference=\"x\"");
        text.replace("valueReference=\"5\"", "valueReference=\"4\"")
            .replace("valueReference=\"x\"", "valueReference=\"5\"")
    });
    let found = problems(swapped);
    // once for each point: the start values and four corners; beyond the range of each input with the policies 0 and 1; and
    // the reference run of each interface
    assert_eq!(found.len(), 5 + 2 * 2 + 2, "{found:?}");
    assert!(found[0].starts_with("behavior: in Initialization Mode, \"angle\" is "), "{found:?}");
}

#[test]
fn a_model_of_another_program_is_not_compared_with() {
    let folder = tempfile::tempdir().unwrap();
    let without = changed_fmu(folder.path(), |entries| entry(entries, MODEL_FILE).0 = "resources/other".into());
    let found = problems(without);
    assert!(found[0].contains("fmi2Instantiate returned no instance"), "{found:?}");
}

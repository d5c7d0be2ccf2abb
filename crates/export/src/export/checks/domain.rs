//! Checks what an FMU of metafmu does outside its training ranges.

use crate::{
    Result,
    fmi::{
        Fmu, FmuInstance, ModelDescription,
        validate::{Area, Notes},
    },
};
use metafmu_runtime::{BuiltIn, Domain, DomainPolicy, Encoding, Evaluator, Input, Role, Surrogate};

/// Largest difference of an output, relative to its largest magnitude in training.
const TOLERANCE: f64 = 1e-9;

/// Value references in the FMU's description: FMUs of other releases may have others than the table of variables.
struct References {
    policy: u32,
    in_domain: u32,
    distance: u32,
    inputs: Vec<u32>,
    outputs: Vec<u32>,
}

impl References {
    /// The references by name; none if the description lacks a variable, as a plain interface lacks those of the domain.
    fn find(fmu: &Fmu, surrogate: &Surrogate) -> Option<Self> {
        let description = fmu.description();
        Some(Self {
            policy: reference(description, BuiltIn::DomainPolicy.name())?,
            in_domain: reference(description, BuiltIn::InDomain.name())?,
            distance: reference(description, BuiltIn::DomainDistance.name())?,
            inputs: surrogate
                .inputs()
                .iter()
                .map(|input| reference(description, &input.name))
                .collect::<Option<_>>()?,
            outputs: surrogate
                .outputs()
                .iter()
                .map(|output| reference(description, &output.name))
                .collect::<Option<_>>()?,
        })
    }
}

fn reference(description: &ModelDescription, name: &str) -> Option<u32> {
    Some(description.variable(name)?.value_reference)
}

/// Reports where the three policies and the two variables of the domain do not hold.
pub fn check(fmu: &Fmu, surrogate: &Surrogate, report: &mut Notes) {
    let Some(references) = References::find(fmu, surrogate) else {
        return report.skipped("the domain of validity: modelDescription.xml lacks its variables");
    };
    for policy in [DomainPolicy::Warn, DomainPolicy::Clamp, DomainPolicy::Error] {
        for column in 0..surrogate.inputs().len() {
            let Input { role, encoding, .. } = &surrogate.inputs()[column];
            // a periodic input is never outside, and a value at the start is where its state is
            if *role == Role::Time || *role == Role::Start || *encoding == Encoding::Periodic {
                continue;
            }
            report.doing(format!("domain_policy {}", policy as i32));
            match outside(fmu, surrogate, &references, policy, column) {
                Ok(None) => {}
                Ok(Some(problem)) => {
                    report.problem(Area::Behavior, format!("domain_policy {}: {problem}", policy as i32))
                }
                Err(error) => report.problem(Area::Behavior, format!("domain_policy {}: {error}", policy as i32)),
            }
        }
    }
}

/// Reports whether a point in the ranges, but far from the training data, counts as inside.
pub fn check_data(fmu: &Fmu, surrogate: &Surrogate, report: &mut Notes) {
    let domain = Domain::of(surrogate);
    if surrogate.metadata().cover.is_none() {
        return;
    }
    let Some(references) = References::find(fmu, surrogate) else { return };
    let Some(point) = far_from_data(&domain, surrogate.inputs()) else { return };
    report.doing("domain of the training data");
    match without_data(fmu, surrogate, &references, &point) {
        Ok(None) => {}
        Ok(Some(problem)) => report.problem(Area::Behavior, format!("far from the training data: {problem}")),
        Err(error) => report.problem(Area::Behavior, format!("far from the training data: {error}")),
    }
}

/// The point in the ranges that is farthest from the domain, of some that are spread evenly.
fn far_from_data(domain: &Domain, inputs: &[Input]) -> Option<Vec<f64>> {
    let farthest = (1..=POINTS)
        .map(|index| -> Vec<f64> {
            inputs
                .iter()
                .enumerate()
                .map(|(column, input)| match input.role {
                    Role::Time | Role::Start => input.start,
                    Role::Parameter(_) | Role::Input => input.min + share(index, column) * (input.max - input.min),
                })
                .collect()
        })
        .max_by(|a, b| domain.distance(a, 0).total_cmp(&domain.distance(b, 0)))?;
    (domain.distance(&farthest, 0) > 1e-6).then_some(farthest)
}

/// Share of the range of a column at a point: a multiple of an irrational number, modulo 1 (Weyl), which is stretched to reach the ends.
fn share(point: usize, column: usize) -> f64 {
    let part = (point as f64 * ((column + 2) as f64).sqrt()).fract();
    (1.2 * part - 0.1).clamp(0.0, 1.0)
}

/// Number of points that are searched for one far from the data.
const POINTS: usize = 4096;

fn without_data(fmu: &Fmu, surrogate: &Surrogate, references: &References, point: &[f64]) -> Result<Option<String>> {
    let instance = fmu.instantiate("domain of the data", true)?;
    let start = surrogate.time_column().map_or(0.0, |time| point[time]);
    instance.enter_initialization_mode(start, None)?;
    for column in
        (0..point.len()).filter(|column| !matches!(surrogate.inputs()[*column].role, Role::Time | Role::Start))
    {
        instance.set_real(&[references.inputs[column]], &[point[column]])?;
    }
    holds(&instance, surrogate, references, DomainPolicy::Warn, point)
}

/// Half a range beyond the largest value of a column; for a nominal one, a quarter of the way between two values.
fn outside_value(input: &Input) -> f64 {
    let Some(values) = input.nominal_values() else {
        return input.max + 0.5 * (input.max - input.min).max(1.0);
    };
    let next = values.iter().copied().filter(|value| *value > input.min).fold(input.max, f64::min);
    0.75 * input.min + 0.25 * next
}

fn outside(
    fmu: &Fmu,
    surrogate: &Surrogate,
    references: &References,
    policy: DomainPolicy,
    column: usize,
) -> Result<Option<String>> {
    let instance = fmu.instantiate("domain", true)?;
    let inputs = surrogate.inputs();
    let mut point: Vec<f64> = inputs.iter().map(|input| input.start).collect();
    let start = surrogate.time_column().map_or(0.0, |time| inputs[time].min);
    if let Some(time) = surrogate.time_column() {
        point[time] = start;
    }
    point[column] = outside_value(&inputs[column]);
    instance.set_integer(&[references.policy], &[policy as i32])?;
    instance.enter_initialization_mode(start, None)?;
    let name = &inputs[column].name;
    let set = instance.set_real(&[references.inputs[column]], &[point[column]]);
    if policy == DomainPolicy::Error {
        return Ok(set.is_ok().then(|| format!("\"{name}\" = {} is accepted, expected an error", point[column])));
    }
    set?;
    holds(&instance, surrogate, references, policy, &point)
        .map(|problem| problem.map(|text| format!("{text} at \"{name}\" = {}", point[column])))
}

fn holds(
    instance: &FmuInstance,
    surrogate: &Surrogate,
    references: &References,
    policy: DomainPolicy,
    point: &[f64],
) -> Result<Option<String>> {
    let domain = Domain::of(surrogate);
    let (mut inside, mut distance) = ([true], [0.0]);
    instance.get_boolean(&[references.in_domain], &mut inside)?;
    instance.get_real(&[references.distance], &mut distance)?;
    if inside[0] {
        return Ok(Some("in_domain is true".into()));
    }
    let mut evaluator = Evaluator::new(surrogate);
    let mut used = vec![0.0; evaluator.columns()];
    used[..point.len()].copy_from_slice(point);
    evaluator.start(&mut used);
    let expected = domain.distance(&used, 0);
    if (distance[0] - expected).abs() > TOLERANCE * expected {
        return Ok(Some(format!("domain_distance is {}, expected {expected}", distance[0])));
    }
    if policy == DomainPolicy::Clamp {
        let clamp = |used: &mut [f64], is_clamped: fn(Role) -> bool| {
            let columns = surrogate.inputs().iter().enumerate().filter(|(_, input)| is_clamped(input.role));
            columns.for_each(|(column, _)| used[column] = domain.clamp(column, used[column]));
        };
        // inputs that act directly do so as clamped
        clamp(&mut used, |role| role == Role::Input);
        evaluator.start(&mut used);
        clamp(&mut used, |_| true);
    }
    let mut expected = vec![0.0; evaluator.results()];
    evaluator.evaluate(&used, &mut expected);
    if !expected.iter().all(|value| value.is_finite()) {
        // equations without a solution, as of links that are too short to be joined: the FMU must refuse to answer
        let answers = references.outputs.iter().all(|output| instance.get_real(&[*output], &mut [0.0]).is_ok());
        return Ok(answers.then(|| "outputs are computed, though the equations have no finite solution".into()));
    }
    for (index, (output, expected)) in surrogate.outputs().iter().zip(expected).enumerate() {
        let mut found = [0.0];
        instance.get_real(&[references.outputs[index]], &mut found)?;
        let scale = output.min.abs().max(output.max.abs()).max(expected.abs()).max(f64::MIN_POSITIVE);
        // written so that NaN is wrong
        let right = (found[0] - expected).abs() <= TOLERANCE * scale;
        if !right {
            return Ok(Some(format!("\"{}\" is {}, expected {expected}", output.name, found[0])));
        }
    }
    Ok(None)
}

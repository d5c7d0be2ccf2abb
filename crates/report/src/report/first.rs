//! The first screen: is the surrogate good enough, where is it worst, where is it valid, and what does a step cost.

use super::{
    Evaluated, Material,
    picture::picture,
    readable::{count, duration, number, percent, r2, short},
    strip::Strip,
};
use crate::{
    evaluation::{Accuracy, OutputMetrics, TestRows},
    html::{self, escape},
};
use metafmu_runtime::{Encoding, Role, Surrogate};
use std::fmt::Write;

/// Reasons of the verdict that are shown; all of them are further down.
pub const REASONS: usize = 2;
/// Values of parameters that a title names.
const VALUES: usize = 4;
/// Outputs with which the table is still short on a phone.
const FEW: usize = 4;

/// The first screen as HTML, from the heading on. `is`: a sentence on what the surrogate is.
pub fn first_screen(material: &Material, is: &str) -> String {
    let Material { study, evaluated, verdict, .. } = material;
    let about = &evaluated.surrogate.metadata().description;
    let about = if about.is_empty() { String::new() } else { format!("{}. ", about.trim_end_matches('.')) };
    let mut page = format!(
        "<header class=\"first{}\">\n<h1>{}</h1>\n{}<div class=\"left\">\n<p class=\"is\">{}{}</p>\n",
        if evaluated.outputs() > FEW { " many" } else { "" },
        escape(&study.name),
        html::verdict(verdict, REASONS),
        escape(&about),
        escape(is)
    );
    // writing to a string does not fail
    let ranges = ranges(evaluated.surrogate, verdict.accepted);
    let _ = write!(page, "<p class=\"cost\"><b>Cost</b> {}</p>\n{ranges}", cost(material));
    page.push_str(&accuracy(material));
    let strips: String = strips(evaluated).iter().filter_map(Strip::html).collect();
    let legend = "<p class=\"legend\"><i class=\"truth\"></i> truth <i class=\"prediction\"></i> prediction \
                  <i class=\"residual\"></i> error";
    let band = if evaluated.surrogate.bounds().is_some() { " <i class=\"band\"></i> bound" } else { "" };
    let _ = write!(page, "</div>\n<div class=\"right\">\n<div class=\"runs\">{strips}{legend}{band}</p></div>\n");
    page.push_str(&mechanism(material).unwrap_or_default());
    page.push_str("</div>\n</header>\n");
    page
}

/// Cost of a step, and speed-up against the source.
fn cost(material: &Material) -> String {
    let is_of_rows = material.evaluated.is_of_rows();
    let step = match (material.step_seconds, is_of_rows) {
        (None, _) => return "not measured: <code>metafmu evaluate</code> measures it".into(),
        (Some(seconds), true) => format!("<b>{}</b> a row on one core", duration(seconds)),
        (Some(seconds), false) => {
            format!("<b>{}</b> a step of {} s on one core", duration(seconds), number(material.study.time.step))
        }
    };
    let source = match material.speed_up {
        Some(times) if times >= 1.0 => format!("<b>{} times</b> as fast as its source", short(times)),
        Some(times) => format!("<b>{} times slower</b> than its source", short(1.0 / times)),
        None => material.no_speed.into(),
    };
    format!("{step}, {source}")
}

/// Where the surrogate is valid, variable by variable, as HTML.
pub fn ranges(surrogate: &Surrogate, accepted: bool) -> String {
    let mut items = Vec::new();
    for input in surrogate.inputs().iter().filter(|input| input.role != Role::Start) {
        let range = match &input.encoding {
            Encoding::Nominal(values) => {
                format!("only {}", values.iter().map(|&value| number(value)).collect::<Vec<_>>().join(", "))
            }
            Encoding::Plain | Encoding::Periodic => format!("{} to {}", number(input.min), number(input.max)),
        };
        items.push(valid_item(&input.name, &format!("{range} {}", input.unit)));
    }
    for state in surrogate.states() {
        let range = match state.range {
            Some([min, max]) => format!("{} to {} {}", number(min), number(max), state.unit),
            None => "any value".into(),
        };
        items.push(valid_item(&state.name, &range));
    }
    if items.is_empty() {
        return String::new();
    }
    let (title, beyond) = match accepted {
        true => ("Valid for", "beyond, the FMU reports <code>in_domain = false</code>"),
        false => ("Trained for", "rejected: not to be used there either"),
    };
    format!("<p class=\"ranges\"><b>{title}</b> {} <small>{beyond}</small></p>\n", items.join(" "))
}

fn valid_item(name: &str, range: &str) -> String {
    format!("<span><code>{}</code> {}</span>", escape(name), escape(range.trim_end()))
}

/// R², largest error and bound of each output.
fn accuracy(material: &Material) -> String {
    let evaluated = material.evaluated;
    let Accuracy { outputs, test_runs, test_rows, rows, .. } = &evaluated.accuracy;
    let rows_text = count(*test_rows);
    let measured = match (rows, material.study.sampling.train_stop) {
        (Some(TestRows::CrossValidated), _) => {
            format!("{rows_text} rows, each predicted without it (cross-validation)")
        }
        (Some(_), _) => format!("{rows_text} unseen rows"),
        (None, Some(stop)) => format!("{} test runs, unseen after {} s", count(*test_runs), number(stop)),
        (None, None) if *test_runs == 1 => format!("1 unseen run, {rows_text} rows"),
        (None, None) => format!("{} unseen runs, {rows_text} rows", count(*test_runs)),
    };
    let bounds = evaluated.surrogate.bounds();
    let bound_heading = bounds.map_or(String::new(), |bounds| {
        let end = if bounds.grow() { " at the end" } else { "" };
        format!("<th>{} bound{end}</th>", percent(bounds.coverage))
    });
    let mut table = format!(
        "<table class=\"accuracy\">\n<caption>On {measured}</caption>\n<tr><th>output</th><th>R²</th><th>largest error, of the range</th>{bound_heading}</tr>\n"
    );
    for (column, metrics) in outputs.values().enumerate() {
        let OutputMetrics { r2: score, max_abs_error, relative_max_error, worst_run, worst_time, .. } = metrics;
        let variable = &evaluated.test.outputs[column];
        let share = relative_max_error.map_or(String::new(), |share| format!("{}, ", percent(share)));
        let place = match evaluated.is_of_rows() {
            true => format!("row {}", worst_run + 1),
            false => format!("run {worst_run}, t = {} s", number(*worst_time)),
        };
        let bound = bounds.map_or(String::new(), |bounds| {
            format!("<td data-heading=\"bound\">±{}</td>", short(bounds.largest(column)))
        });
        let _ = writeln!(
            table,
            "<tr><td><code>{}</code> <small>{}</small></td><td data-heading=\"R²\">{}</td>\
             <td data-heading=\"largest error\">{} <small>{share}{place}</small></td>{bound}</tr>",
            escape(&variable.name),
            escape(&variable.unit),
            score.map_or("constant".into(), r2),
            short(*max_abs_error)
        );
    }
    table + "</table>\n"
}

/// The output that is predicted worst.
fn worst_output(evaluated: &Evaluated) -> usize {
    let scores = evaluated.accuracy.outputs.values().map(|metrics| metrics.r2.unwrap_or(1.0)).enumerate();
    scores.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(column, _)| column)
}

/// Worst and median run in the output that is predicted worst; for a static map its rows, in the order of the truth.
fn strips(evaluated: &Evaluated) -> Vec<Strip> {
    let order = evaluated.runs_by_error();
    let (Some(&worst), false) = (order.last(), evaluated.outputs() == 0) else { return Vec::new() };
    let column = worst_output(evaluated);
    if evaluated.is_of_rows() {
        return vec![of_rows(evaluated, column, [order[(order.len() - 1) / 2], worst])];
    }
    match order.len() {
        1 => vec![of_run(evaluated, column, worst, "The only run".into())],
        _ => ["Worst", "Median"]
            .into_iter()
            .zip([worst, order[(order.len() - 1) / 2]])
            .map(|(which, run)| of_run(evaluated, column, run, format!("{which} of {} runs", count(order.len()))))
            .collect(),
    }
}

/// Name and unit of an output.
fn quantity(evaluated: &Evaluated, column: usize) -> [String; 2] {
    let output = &evaluated.test.outputs[column];
    [output.name.clone(), output.unit.clone()]
}

fn of_run(evaluated: &Evaluated, column: usize, run: usize, title: String) -> Strip {
    let rows: Vec<[f64; 3]> = evaluated.rows(run, column).map(|row| [row.time, row.label, row.prediction]).collect();
    let error = percent(evaluated.run_errors()[run]);
    Strip {
        title,
        about: format!("run {run}, RMS error {error} of the range: {}", values(evaluated, run)),
        ends: [rows.first(), rows.last()].map(|row| row.map_or(String::new(), |row| format!("{} s", number(row[0])))),
        bound: rows.iter().map(|row| evaluated.bound(column, row[0])).collect(),
        quantity: quantity(evaluated, column),
        rows,
    }
}

fn of_rows(evaluated: &Evaluated, column: usize, [median, worst]: [usize; 2]) -> Strip {
    let rows = (0..evaluated.test.runs.len()).filter_map(|run| evaluated.rows(run, column).next());
    let mut rows: Vec<[f64; 3]> = rows.map(|row| [0.0, row.label, row.prediction]).collect();
    rows.sort_by(|a, b| a[1].total_cmp(&b[1]));
    (0u32..).zip(&mut rows).for_each(|(rank, row)| row[0] = f64::from(rank));
    let [worst_error, median_error] = [worst, median].map(|run| percent(evaluated.run_errors()[run]));
    Strip {
        title: format!("{} rows by rising truth", count(rows.len())),
        about: format!(
            "worst row {}, off by {worst_error} of the range: {}; median row off by {median_error}",
            worst + 1,
            values(evaluated, worst)
        ),
        quantity: quantity(evaluated, column),
        ends: ["smallest".into(), "largest".into()],
        bound: rows.iter().map(|_| evaluated.bound(column, 0.0)).collect(),
        rows,
    }
}

/// Values of the first parameters of a run.
fn values(evaluated: &Evaluated, run: usize) -> String {
    let pairs = evaluated.test.parameters.iter().zip(&evaluated.test.runs[run].parameters);
    let text = pairs.take(VALUES).map(|(variable, &value)| {
        format!("{} = {} {}", variable.name, short(value), variable.unit).trim_end().to_owned()
    });
    let more = if evaluated.test.parameters.len() > VALUES { ", …" } else { "" };
    text.collect::<Vec<_>>().join(", ") + more
}

/// The mechanism at the worst instant of the worst run.
fn mechanism(material: &Material) -> Option<String> {
    let evaluated = material.evaluated;
    let run = *evaluated.runs_by_error().last()?;
    let columns: Vec<Vec<_>> = (0..evaluated.outputs()).map(|column| evaluated.rows(run, column).collect()).collect();
    let times = &evaluated.test.runs[run].times;
    let first = times.len() - columns.first()?.len();
    let errors = (0..columns[0].len()).map(|row| {
        let errors = columns.iter().enumerate().map(|(column, rows)| rows[row].error().abs() / evaluated.range(column));
        errors.fold(0.0, f64::max)
    });
    let (worst, _) = errors.enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b))?;
    picture(material.mechanism.as_ref()?, times, first + worst)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        evaluation::{AcceptanceCheck, Findings, Reason, Verdict},
        report::testing,
    };

    #[test]
    fn the_worst_output_and_the_worst_and_the_median_run_are_shown() {
        let (surrogate, mut test) = testing::exact();
        test.runs[3].outputs[5 * 2 + 1] -= 0.25;
        let evaluated = Evaluated::new(&surrogate, &test);
        let strips = strips(&evaluated);
        assert_eq!(
            strips.iter().map(|strip| strip.title.as_str()).collect::<Vec<_>>(),
            ["Worst of 12 runs", "Median of 12 runs"]
        );
        assert_eq!(strips[0].quantity[0], "velocity");
        assert!(strips[0].about.starts_with("run 3, RMS error "), "{}", strips[0].about);
        assert!(strips[0].about.contains("length = 0.185 m, speed = "), "{}", strips[0].about);
        let off = strips[0].rows.iter().filter(|row| (row[2] - row[1] - 0.25).abs() < 1e-9).count();
        assert_eq!((off, strips[0].rows.len()), (1, 21));
        assert!(strips[1].rows.iter().all(|row| row[1] == row[2]));
        test.runs.truncate(1);
        let single = super::strips(&Evaluated::new(&surrogate, &test));
        assert_eq!(single.iter().map(|strip| strip.title.as_str()).collect::<Vec<_>>(), ["The only run"]);
    }

    #[test]
    fn the_first_screen_has_verdict_ranges_errors_and_cost() {
        let (surrogate, mut test) = testing::exact();
        test.runs[3].outputs[5 * 2] -= 0.25;
        let evaluated = Evaluated::new(&surrogate, &test);
        let study = testing::study();
        let reason = |(place, cause): (&str, &str)| Reason::new(AcceptanceCheck::Accuracy, place, cause);
        let reasons = [("angle", "R² 0.5"), ("", "second"), ("", "third <3>")].map(reason).to_vec();
        let verdict = Verdict::of(Findings { problems: reasons, ..Findings::default() });
        let material = Material {
            step_seconds: Some(1.24e-6),
            speed_up: Some(0.5),
            ..testing::material(&study, &evaluated, &verdict)
        };
        let page = first_screen(&material, "A network gives <2> outputs.");
        for piece in [
            "<div class=\"verdict rejected\"><p><strong>Rejected</strong>",
            "<li>angle: R² 0.5</li>",
            "A network gives &lt;2&gt; outputs.",
            "<b>Trained for</b> <span><code>length</code> 0.1 to 0.2 m</span>",
            "<b>1.2\u{a0}µs</b> a step of 0.1 s on one core, <b>2 times slower</b> than its source",
            "On 12 unseen runs, 252 rows",
            "<td data-heading=\"largest error\">0.25 <small>",
            "run 3, t = 0.5 s</small>",
        ] {
            assert!(page.contains(piece), "{piece} is not in {page}");
        }
        assert!(!page.contains("third"), "two reasons are enough here: {page}");
        let verdict = Verdict::of(Findings::default());
        let page = first_screen(&testing::material(&study, &evaluated, &verdict), "");
        assert!(page.contains("<b>Valid for</b>") && page.contains("not measured"), "{page}");
    }
}

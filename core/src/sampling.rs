//! Where in the parameters' ranges runs are placed.

use crate::{
    Result,
    study::{MAX_HALTON_PARAMETERS, Method, ParameterOptions, Study},
};
use metafmu_runtime::Rows;
use rand::{Rng, SeedableRng, rngs::ChaCha8Rng, seq::SliceRandom};
use sobol::{Sobol, params::JoeKuoD6};
use std::collections::HashSet;

/// Sets of a study's runs by purpose; no run belongs to two of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Sets<T> {
    /// Training, the runs held out for validation included.
    pub train: T,
    /// Measuring the accuracy.
    pub test: T,
    /// Measuring the error bounds; empty if none are wanted.
    pub calibration: T,
}

impl<T> Sets<T> {
    /// Each set with its name.
    pub fn named(&self) -> [(&'static str, &T); 3] {
        [("train", &self.train), ("test", &self.test), ("calibration", &self.calibration)]
    }

    /// Makes something of each set.
    ///
    /// # Errors
    /// The first error of `make`.
    pub fn try_map<U>(self, mut make: impl FnMut(T) -> Result<U>) -> Result<Sets<U>> {
        Ok(Sets { train: make(self.train)?, test: make(self.test)?, calibration: make(self.calibration)? })
    }
}

/// Parameter values of every run, one row a run.
pub type Plan = Sets<Rows>;

/// Bases of Halton's sequences. Larger ones fill the ranges only after very many points.
const HALTON_BASES: [u8; MAX_HALTON_PARAMETERS] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53];

/// Purpose of a stream of random numbers; streams of one seed are independent of each other.
#[derive(Clone, Copy, Debug)]
pub enum Stream {
    /// Placing training runs.
    Train = 1,
    /// Placing test runs.
    Test = 2,
    /// Choosing the runs held out for validation.
    Validation = 3,
    /// Choosing the values of a search's trials.
    Search = 4,
    /// Placing the runs that error bounds are measured on.
    Calibration = 5,
    /// Choosing rows for baselines that take not all of them.
    Baselines = 6,
    /// Placing runs that are added until a target is met.
    Refinement = 7,
    /// Placing the next rows of a table.
    Design = 8,
}

/// The random numbers of a seed for one purpose: the same on every platform.
pub fn random(seed: u64, stream: Stream) -> ChaCha8Rng {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    generator.set_stream(stream as u64);
    generator
}

impl Plan {
    /// The plan of a study whose runs are simulated; the same study always has the same one.
    pub fn new(study: &Study) -> Self {
        Self::with_calibration(study, study.calibration_runs())
    }

    /// The plan of a study with this number of calibration runs; a larger number begins with the same runs.
    pub fn with_calibration(study: &Study, calibration_runs: usize) -> Self {
        let parameters: Vec<&ParameterOptions> = study.planned().map(|(_, options)| options).collect();
        let (count, runs) = (parameters.len(), study.sampling.runs.unwrap_or(0));
        let (mut generator, faces) = (random(study.seed, Stream::Train), study.faces());
        let train = match study.sampling.method {
            None if study.runs().have_memory => {
                place(&parameters, 0.0, uniform(count, generator)).take(study.train_runs() as usize).collect()
            }
            None => Rows::default(),
            Some(Method::Mesh) => mesh(&parameters, study.sampling.levels),
            Some(Method::Random) => place(&parameters, faces, uniform(count, generator)).take(runs).collect(),
            Some(Method::LatinHypercube) => {
                let points = latin_hypercube(count, runs, &mut generator);
                place(&parameters, faces, points.iter().map(<[f64]>::to_vec)).collect()
            }
            Some(Method::Sobol) => place(&parameters, faces, sobol(count, generator)).take(runs).collect(),
            Some(Method::Halton) => place(&parameters, faces, halton(count, generator)).take(runs).collect(),
            Some(Method::List) => study.points().unwrap_or_default().iter().collect(),
        };
        // zeros of both signs are one value
        let bits = |point: &[f64]| point.iter().map(|value| (value + 0.0).to_bits()).collect::<Vec<u64>>();
        let seen: HashSet<Vec<u64>> = train.iter().map(bits).collect();
        let unseen = |point: &Vec<f64>| !seen.contains(&bits(point.as_slice()));
        // where no parameter has a range, training may have seen all points that exist
        let has_range = parameters.iter().any(|options| options.values.is_empty() && options.min < options.max);
        let draws = |runs: usize| if has_range { usize::MAX } else { 64 * runs };
        let fresh = |stream, runs| {
            let points = place(&parameters, 0.0, uniform(count, random(study.seed, stream)));
            points.take(draws(runs)).filter(unseen).take(runs).collect()
        };
        Self {
            test: fresh(Stream::Test, study.sampling.test_runs),
            calibration: fresh(Stream::Calibration, calibration_runs),
            train,
        }
    }
}

/// Every combination of evenly spaced levels or nominal values; the last parameter changes fastest.
fn mesh(parameters: &[&ParameterOptions], levels: Option<usize>) -> Rows {
    parameters.iter().fold(Rows::zeros(0, 1), |points, parameter| {
        // a validated study has levels for every parameter
        let levels = parameter.mesh(parameter.levels.or(levels).unwrap_or(2).max(2));
        points.iter().flat_map(|point| levels.iter().map(move |level| [point, &[*level]].concat())).collect()
    })
}

/// The parameter values of points of the unit cube.
///
/// A share `faces` of the points lies on the ends of each range, half of it on either: `u` becomes
/// `clip((u - faces / 2) / (1 - faces), 0, 1)`. A network is worst at the faces of the box it was trained in, for nothing holds it from
/// outside. Nominal and periodic parameters have no ends. Of points that coincide on the faces, as corners do, the later ones stay inside.
pub fn place(
    parameters: &[&ParameterOptions],
    faces: f64,
    points: impl Iterator<Item = Vec<f64>>,
) -> impl Iterator<Item = Vec<f64>> {
    let parameters: Vec<ParameterOptions> = parameters.iter().map(|&parameter| parameter.clone()).collect();
    let mut on_faces = HashSet::new();
    points.map(move |point| {
        let value = |faces: f64| {
            let values = point.iter().zip(&parameters).map(|(&u, parameter)| match parameter.has_faces() {
                true => parameter.at(((u - 0.5 * faces) / (1.0 - faces)).clamp(0.0, 1.0)),
                false => parameter.at(u),
            });
            values.collect::<Vec<f64>>()
        };
        let placed = value(faces);
        let is_new = faces == 0.0 || on_faces.insert(placed.iter().map(|value| value.to_bits()).collect::<Vec<_>>());
        if is_new { placed } else { value(0.0) }
    })
}

/// Latin hypercube (McKay, Beckman, Conover 1979) of the unit cube: each of `runs` equal slices of each coordinate has one point, at
/// random in it. It is made for its number of runs: a longer plan does not begin with a shorter one.
pub fn latin_hypercube(parameters: usize, runs: usize, generator: &mut ChaCha8Rng) -> Rows {
    let mut points = Rows::zeros(parameters, runs);
    for parameter in 0..parameters {
        let mut slices: Vec<usize> = (0..runs).collect();
        slices.shuffle(generator);
        for (run, slice) in slices.into_iter().enumerate() {
            points[run][parameter] = (slice as f64 + unit_interval(generator)) / runs as f64;
        }
    }
    points
}

/// Halton's sequences in the first primes, each moved by a random distance around the unit circle (Cranley, Patterson 1976):
/// any first `n` points of a longer plan are the plan of `n`.
fn halton(parameters: usize, mut generator: ChaCha8Rng) -> impl Iterator<Item = Vec<f64>> {
    let columns: Vec<(u8, f64)> =
        HALTON_BASES.into_iter().take(parameters).map(|base| (base, unit_interval(&mut generator))).collect();
    (1..).map(move |index| columns.iter().map(|(base, shift)| (halton::number(*base, index) + shift).fract()).collect())
}

/// Independent points, uniform over the unit cube.
pub fn uniform(parameters: usize, mut generator: ChaCha8Rng) -> impl Iterator<Item = Vec<f64>> {
    std::iter::repeat_with(move || (0..parameters).map(|_| unit_interval(&mut generator)).collect())
}

/// Sobol's sequence with the direction numbers of Joe and Kuo (2008). Each coordinate is shifted by a random binary
/// number (digital shift), which keeps its even spread. The first `n` points of a longer plan are the plan of `n`
/// points.
fn sobol(parameters: usize, mut generator: ChaCha8Rng) -> impl Iterator<Item = Vec<f64>> {
    const BITS: f64 = (1u64 << 53) as f64;
    let shifts: Vec<u64> = (0..parameters).map(|_| generator.next_u64() >> 11).collect();
    Sobol::<f64>::new(parameters, &JoeKuoD6::minimal()).map(move |point| {
        point.iter().zip(&shifts).map(|(x, shift)| ((x * BITS) as u64 ^ shift) as f64 / BITS).collect()
    })
}

/// The numbers below `count` in random order.
pub fn permutation(count: usize, mut generator: ChaCha8Rng) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    order.shuffle(&mut generator);
    order
}

/// Uniform over `[0, 1)` with all 53 bits a double can hold there.
fn unit_interval(generator: &mut ChaCha8Rng) -> f64 {
    (generator.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn study(edit: impl Fn(String) -> String) -> Study {
        let text = edit(include_str!("../../examples/paper/single-pendulum.toml").to_owned());
        Study::parse(&text, Path::new("s.toml")).unwrap()
    }

    #[test]
    fn the_mesh_has_every_combination_once_and_both_ends() {
        let plan = Plan::new(&study(|text| text));
        assert_eq!(plan.train.len(), 11 * 11 * 11);
        assert_eq!(plan.train[0], [0.1, 0.0, 0.0]);
        assert_eq!(plan.train[1], [0.1, 0.0, 0.5]);
        assert_eq!(plan.train[1330], [0.2, 0.15, 5.0]);
        let mut sorted: Vec<&[f64]> = plan.train.iter().collect();
        sorted.sort_by(|a, b| a.partial_cmp(b).unwrap());
        sorted.dedup();
        assert_eq!(sorted.len(), 1331);
    }

    #[test]
    fn a_parameter_may_have_levels_of_its_own() {
        let plan = Plan::new(&study(|text| text.replacen("max = 0.2,", "max = 0.2, levels = 3,", 1)));
        assert_eq!(plan.train.len(), 3 * 11 * 11);
    }

    #[test]
    fn random_points_lie_in_the_ranges_and_repeat_for_a_seed_only() {
        let random = |text: String| {
            text.replace("method = \"mesh\"", "method = \"random\"\nfaces = 0.0").replace("levels = 11", "runs = 500")
        };
        let plan = Plan::new(&study(random));
        assert_eq!((plan.train.len(), plan.test.len()), (500, 200));
        for point in plan.train.iter().chain(&plan.test) {
            assert!(
                (0.1..0.2).contains(&point[0]) && (0.0..0.15).contains(&point[1]) && (0.0..5.0).contains(&point[2])
            );
        }
        assert_eq!(plan, Plan::new(&study(random)));
        assert_ne!(plan, Plan::new(&study(|text| random(text).replace("seed = 1", "seed = 2"))));
        let mean = plan.train.iter().map(|point| point[2]).sum::<f64>() / 500.0;
        assert!((mean - 2.5).abs() < 0.25, "the mean of 500 points is within 4 standard deviations: {mean}");
    }

    #[test]
    fn sobol_points_fill_every_cell_once_and_a_shorter_plan_begins_a_longer_one() {
        let points = runs("sobol", 1024);
        assert_eq!(points.part(0..100), runs("sobol", 100));
        let ranges = [(0.1, 0.2), (0.0, 0.15), (0.0, 5.0)];
        let cell = |point: &[f64], column: usize, cells: f64| {
            ((point[column] - ranges[column].0) / (ranges[column].1 - ranges[column].0) * cells) as usize
        };
        for column in 0..3 {
            let mut seen = vec![0; 1024];
            points.iter().for_each(|point| seen[cell(point, column, 1024.0)] += 1);
            assert_eq!(seen, vec![1; 1024], "each 1024th of column {column} has one point");
        }
        // the first two coordinates are a (0, 2)-sequence: one point in each of 32 x 32 cells
        let mut seen = vec![0; 1024];
        points.iter().for_each(|point| seen[32 * cell(point, 0, 32.0) + cell(point, 1, 32.0)] += 1);
        assert_eq!(seen, vec![1; 1024]);
    }

    fn runs(method: &str, runs: usize) -> Rows {
        runs_with(method, runs, "faces = 0.0")
    }

    fn runs_with(method: &str, runs: usize, more: &str) -> Rows {
        let text = |text: String| {
            text.replace("method = \"mesh\"", &format!("method = \"{method}\""))
                .replace("levels = 11", &format!("runs = {runs}\n{more}"))
        };
        Plan::new(&study(text)).train
    }

    /// The points on the unit cube.
    fn unit(points: &Rows) -> Vec<[f64; 3]> {
        points.iter().map(|p| [(p[0] - 0.1) / 0.1, p[1] / 0.15, p[2] / 5.0]).collect()
    }

    #[test]
    fn a_latin_hypercube_has_one_point_in_each_slice_of_each_range() {
        let points = runs("latin-hypercube", 500);
        for column in 0..3 {
            let mut slices: Vec<usize> = unit(&points).iter().map(|point| (point[column] * 500.0) as usize).collect();
            assert_ne!(slices, (0..500).collect::<Vec<_>>());
            slices.sort_unstable();
            assert_eq!(slices, (0..500).collect::<Vec<_>>());
        }
        assert_eq!(points, runs("latin-hypercube", 500));
        // the columns are in orders of their own: 500 points of uncorrelated columns, 4 standard deviations
        let correlation = unit(&points).iter().map(|p| (p[0] - 0.5) * (p[1] - 0.5)).sum::<f64>() / 500.0 * 12.0;
        assert!(correlation.abs() < 4.0 / 500f64.sqrt(), "{correlation}");
    }

    #[test]
    fn halton_points_leave_no_gap_and_a_shorter_plan_begins_a_longer_one() {
        for (column, count) in [(0, 1 << 10), (1, 3usize.pow(6)), (2, 5usize.pow(4))] {
            let points = runs("halton", count - 1);
            assert_eq!(points.part(0..100), runs("halton", 100));
            let mut places: Vec<f64> = unit(&points).iter().map(|point| point[column]).collect();
            places.sort_by(f64::total_cmp);
            let around = 1.0 + places[0] - places[places.len() - 1];
            let gap = places.windows(2).map(|pair| pair[1] - pair[0]).fold(around, f64::max);
            // all multiples of 1 / count but zero, moved around the circle
            assert!((gap * count as f64 - 2.0).abs() < 1e-9, "column {column}: {gap}");
        }
    }

    #[test]
    fn the_points_of_a_list_are_taken_as_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let text =
            include_str!("../../examples/paper/single-pendulum.toml").replace("method = \"mesh\"", "method = \"list\"");
        let text = text.replace("levels = 11", "file = \"points.csv\"");
        let path = folder.path().join("study.toml");
        let read = |list: &str| {
            std::fs::write(folder.path().join("points.csv"), list).unwrap();
            Study::parse(&text, &path)
        };
        let study = read("note;c;L [m];thetad0\nfirst;0,1;0,15;2\nsecond;0;0,2;5\n").unwrap();
        let plan = Plan::new(&study);
        assert_eq!(plan.train, Rows::from_iter([[0.15, 0.1, 2.0], [0.2, 0.0, 5.0]]));
        assert_eq!((plan.test.len(), study.train_runs()), (200, 2));
        let other = read("c,L,thetad0\n0.1,0.15,2\n0,0.2,4.9\n").unwrap();
        assert_ne!(other.sampling_digest(), study.sampling_digest());
        for (list, says) in [
            ("L,c\n0.1,0\n", "points.csv:1: no column `thetad0`, expected it among L, c"),
            ("L [mm],c,thetad0\n100,0,0\n", "points.csv:1: column `L`: unit `mm`, expected `m`"),
            ("L,c,thetad0\n0.1,0,0\n0.3,0,0\n", "points.csv:3: column `L`: 0.3, expected 0.1 to 0.2"),
            ("L,c,thetad0\n0.1,0,0\n0.1,0,1\n0.10,0.0,-0\n", "points.csv:4: the point of line 2 again"),
            ("L,c,thetad0\n0.1,0,0\n", "points.csv:2: 1 points, expected at least 2"),
        ] {
            let message = read(list).unwrap_err().to_string();
            assert!(message.contains(says), "{message} should contain {says}");
        }
    }

    /// The study of the paper with `L` one of three values and `thetad0` periodic.
    fn encoded(text: String) -> String {
        text.replacen("L = { min = 0.1, max = 0.2,", "L = { values = [0.15, 0.1, 0.2],", 1).replacen(
            "thetad0 = { min = 0.0, max = 5.0,",
            "thetad0 = { min = 0.0, max = 5.0, periodic = true,",
            1,
        )
    }

    #[test]
    fn nominal_parameters_have_the_listed_values_only_and_each_equally_often() {
        for method in ["random", "sobol", "halton", "latin-hypercube"] {
            let study = study(|text| {
                let text = encoded(text).replace("method = \"mesh\"", &format!("method = \"{method}\""));
                format!("{}\n[bounds]\nruns = 50\n", text.replace("levels = 11", "runs = 600"))
            });
            let plan = Plan::new(&study);
            assert_eq!((plan.train.len(), plan.test.len(), plan.calibration.len()), (600, 200, 50));
            let count = |points: &Rows, value: f64| points.iter().filter(|point| point[0] == value).count();
            for (_, points) in plan.named() {
                let listed: usize = [0.15, 0.1, 0.2].iter().map(|&value| count(points, value)).sum();
                assert_eq!(listed, points.len(), "{method}");
            }
            // of 600 random points 200 +- 11.5 have each value: 4 standard deviations
            for value in [0.15, 0.1, 0.2] {
                assert!(count(&plan.train, value).abs_diff(200) <= 46, "{method}");
            }
        }
    }

    #[test]
    fn a_mesh_has_all_nominal_values_and_leaves_out_the_end_that_is_the_beginning_again() {
        let study = study(encoded);
        let plan = Plan::new(&study);
        assert_eq!((plan.train.len(), study.train_runs()), (3 * 11 * 11, 3 * 11 * 11));
        assert_eq!((&plan.train[0][..], plan.train[362][0]), (&[0.15, 0.0, 0.0][..], 0.2));
        assert!((plan.train[362][2] - 50.0 / 11.0).abs() < 1e-12);
    }

    #[test]
    fn a_list_must_hold_listed_values() {
        let folder = tempfile::tempdir().unwrap();
        let text = encoded(include_str!("../../examples/paper/single-pendulum.toml").to_owned());
        let text = text.replace("method = \"mesh\"", "method = \"list\"").replace("levels = 11", "file = \"p.csv\"");
        let read = |list: &str| {
            std::fs::write(folder.path().join("p.csv"), list).unwrap();
            Study::parse(&text, &folder.path().join("study.toml"))
        };
        // the very value of the study is taken
        let study = read("L,c,thetad0\n0.2,0,0\n0.15000000000001,0,0\n").unwrap();
        assert_eq!(Plan::new(&study).train, Rows::from_iter([[0.2, 0.0, 0.0], [0.15, 0.0, 0.0]]));
        let message = read("L,c,thetad0\n0.2,0,0\n0.16,0,0\n").unwrap_err().to_string();
        let says = "p.csv:3: column `L`: 0.16, expected one of 0.15, 0.1, 0.2, the study's values";
        assert!(message.contains(says), "{message}");
    }

    #[test]
    fn sobol_points_exist_up_to_the_stated_number_of_parameters() {
        let mut points = sobol(crate::study::MAX_SOBOL_PARAMETERS, random(1, Stream::Train));
        assert_eq!(points.next().unwrap().len(), crate::study::MAX_SOBOL_PARAMETERS);
    }

    #[test]
    fn a_share_of_the_points_lies_on_the_ends_of_each_range_and_none_twice() {
        for method in ["random", "sobol", "halton", "latin-hypercube"] {
            let points = runs_with(method, 2000, "faces = 0.2");
            for (column, (min, max)) in [(0.1, 0.2), (0.0, 0.15), (0.0, 5.0)].into_iter().enumerate() {
                let count = |end: f64| points.iter().filter(|point| point[column] == end).count();
                for end in [min, max] {
                    // a binomial number of 2000 points with a mean of 200: 5 standard deviations
                    assert!((133..=267).contains(&count(end)), "{method}: {} points at {end}", count(end));
                }
                assert!(points.iter().all(|point| (min..=max).contains(&point[column])));
            }
            let mut sorted: Vec<Vec<u64>> =
                points.iter().map(|point| point.iter().map(|value| value.to_bits()).collect()).collect();
            sorted.sort_unstable();
            sorted.dedup();
            assert_eq!(sorted.len(), points.len(), "{method}");
            let none = runs_with(method, 2000, "faces = 0.0");
            assert!(none.iter().all(|point| point[1] > 0.0 && point[2] > 0.0), "{method}");
            if method != "latin-hypercube" {
                assert_eq!(points.part(0..500), runs_with(method, 500, "faces = 0.2"), "{method}");
            }
        }
    }

    #[test]
    fn one_parameter_has_a_run_at_each_end_and_no_more() {
        let edit = |text: String| {
            let lines: Vec<&str> =
                text.lines().filter(|line| !line.starts_with("c =") && !line.starts_with("thetad0 =")).collect();
            lines
                .join("\n")
                .replace("method = \"mesh\"", "method = \"sobol\"")
                .replace("levels = 11", "runs = 100\nfaces = 0.1")
        };
        let mut points: Vec<f64> = Plan::new(&study(edit)).train.iter().map(|point| point[0]).collect();
        points.sort_by(f64::total_cmp);
        assert_eq!((points[0], points[99]), (0.1, 0.2));
        assert!(points.windows(2).all(|pair| pair[0] < pair[1]), "{points:?}");
    }

    #[test]
    fn nominal_and_periodic_parameters_have_no_faces() {
        let edit = |text: String| {
            text.replace("method = \"mesh\"", "method = \"random\"\nfaces = 0.5")
                .replace("levels = 11", "runs = 300")
                .replace("max = 5.0", "max = 5.0, periodic = true")
                .replace("min = 0.0, max = 0.15", "values = [0, 0.1, 0.15]")
        };
        let points = Plan::new(&study(edit)).train;
        assert!(points.iter().all(|point| point[2] > 0.0 && point[2] < 5.0));
        for value in [0.0, 0.1, 0.15] {
            let count = points.iter().filter(|point| point[1] == value).count();
            assert!((59..=141).contains(&count), "a third of 300: {count}");
        }
        assert!(points.iter().filter(|point| point[0] == 0.1).count() > 30);
    }

    #[test]
    fn no_test_run_is_a_training_run() {
        let plan = Plan::new(&study(|text| text));
        assert!(plan.test.iter().all(|point| !plan.train.contains(point)));
    }
}

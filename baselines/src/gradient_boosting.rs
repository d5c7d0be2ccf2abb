//! Gradient boosting on binned columns: each tree corrects the residual of the trees before it.
//!
//! The residual is `r = y - f` with the sum `f` of the trees so far. A node of `n` rows whose residuals sum to `G` adds
//! `shrinkage * G / (n + L2)`. It is split where `G_l^2 / (n_l + L2) + G_r^2 / (n_r + L2) - G^2 / (n + L2)` is largest,
//! if that is positive (Chen and Guestrin, XGBoost, 2016, with squared errors). Splits lie between bins of about equal
//! numbers of rows, so the sums of a histogram determine the split (Ke et al., LightGBM, 2017). The histogram of a
//! child is that of its parent minus that of its smaller sibling.

use crate::{Baseline, BaselineCause, BaselineError, Fitted, StandardizedRows, for_each_output, tree::MARGIN};
use metafmu_core::study::baselines::GradientBoosting;
use metafmu_runtime::graph::{Forest, Graph, LEAF, Node, Tree};

/// Most bins of a column.
const BINS: usize = 256;
/// Penalty on the squares of the leaves, as XGBoost's default.
const L2: f64 = 1.0;

impl Baseline for GradientBoosting {
    fn most_rows(&self) -> Option<usize> {
        Some(self.rows)
    }

    fn fit(&self, rows: &StandardizedRows, _: u64) -> Result<Fitted, BaselineError> {
        if rows.x.len() != rows.len() * rows.inputs || rows.y.len() != rows.len() * rows.outputs {
            let message = format!("{} numbers of outputs for {} rows", rows.y.len(), rows.len());
            return Err(BaselineError::new(BaselineCause::Rows, message));
        }
        let binned = BinnedInputs::new(rows);
        let fitted = for_each_output(rows, |output| Ok(trees(self, &binned, rows.output(output))))?;
        let mut forest = Forest::default();
        for (output, trees) in (0..).zip(fitted) {
            for tree in trees {
                let root = u32::try_from(forest.nodes.len()).map_err(BaselineError::too_many_nodes)?;
                forest.trees.push(Tree { root, output });
                forest.nodes.extend(tree.into_iter().map(|node| Node {
                    below: node.below.map(|below| if node.column == LEAF { 0 } else { root + below }),
                    ..node
                }));
            }
        }
        Ok(Fitted::Formula(Graph::of_forest(&rows.scaling, forest)))
    }
}

/// The trees of an output, whose residual is `residual` at first.
fn trees(options: &GradientBoosting, binned: &BinnedInputs, mut residual: Vec<f64>) -> Vec<Vec<Node>> {
    let mut order: Vec<u32> = (0..residual.len() as u32).collect();
    (0..options.trees).map(|_| tree(options, binned, &mut residual, &mut order)).collect()
}

/// A tree, level by level, which is taken off the residual; `order`: the rows, in any order.
fn tree(options: &GradientBoosting, binned: &BinnedInputs, residual: &mut [f64], order: &mut [u32]) -> Vec<Node> {
    let mut nodes = vec![LEAF_NODE];
    let mut level = vec![Open { node: 0, first: 0, end: order.len(), histogram: binned.histogram(order, residual) }];
    for depth in 0..=options.depth {
        let mut next = Vec::new();
        for open in level {
            let rows = open.first..open.end;
            let split = (depth < options.depth).then(|| open.histogram.best_split(binned)).flatten();
            let Some(Split { column, bin }) = split else {
                let value = options.learning_rate * open.histogram.value();
                nodes[open.node].number = value;
                order[rows].iter().for_each(|row| residual[*row as usize] -= value);
                continue;
            };
            let below = nodes.len();
            nodes.resize(below + 2, LEAF_NODE);
            nodes[open.node] = Node {
                column: column as u32,
                number: binned.edges[column][bin],
                below: [below as u32, below as u32 + 1],
            };
            let middle = open.first + partition(&mut order[rows], |row| binned.bin(row, column) <= bin);
            next.extend(open.divided(binned, residual, order, [below, middle]));
        }
        level = next;
    }
    nodes
}

const LEAF_NODE: Node = Node { column: LEAF, number: 0.0, below: [0; 2] };

/// Moves the rows that fulfil a condition to the front; their number.
fn partition(rows: &mut [u32], is_first: impl Fn(u32) -> bool) -> usize {
    let mut front = 0;
    for place in 0..rows.len() {
        if is_first(rows[place]) {
            rows.swap(front, place);
            front += 1;
        }
    }
    front
}

/// Inputs as numbers of bins.
struct BinnedInputs {
    /// Upper ends of the bins of each column, except the last bin.
    edges: Vec<Vec<f64>>,
    /// Shape `[rows, columns]`.
    bins: Vec<u8>,
}

impl BinnedInputs {
    fn new(rows: &StandardizedRows) -> Self {
        let columns = rows.inputs;
        let edges: Vec<Vec<f64>> =
            (0..columns).map(|column| edges(rows.x.iter().skip(column).step_by(columns).copied().collect())).collect();
        let values = rows.x.iter().zip(edges.iter().cycle());
        let bins = values.map(|(value, edges)| edges.partition_point(|edge| edge < value) as u8).collect();
        Self { edges, bins }
    }

    fn columns(&self) -> usize {
        self.edges.len()
    }

    fn bin(&self, row: u32, column: usize) -> usize {
        self.bins[row as usize * self.columns() + column].into()
    }

    fn histogram(&self, rows: &[u32], residual: &[f64]) -> NodeHistogram {
        let columns = self.columns();
        let mut sums = vec![ResidualSum::default(); columns * BINS];
        for &row in rows {
            let value = residual[row as usize];
            let bins = &self.bins[row as usize * columns..][..columns];
            for (sums, bin) in sums.chunks_exact_mut(BINS).zip(bins) {
                let sum = &mut sums[usize::from(*bin)];
                sum.residual += value;
                sum.rows += 1.0;
            }
        }
        NodeHistogram(sums)
    }
}

/// Ends between bins of about as many values each, in the middle between two values; values that differ by rounding are in one bin.
fn edges(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let mut places: Vec<usize> =
        (1..values.len()).filter(|place| values[*place] - values[place - 1] > 4.0 * MARGIN).collect();
    if places.len() >= BINS {
        // the next place between values that differ, from each quantile on
        places = (1..BINS)
            .filter_map(|bin| places.get(places.partition_point(|place| *place < bin * values.len() / BINS)).copied())
            .collect();
        places.dedup();
    }
    places.into_iter().map(|place| 0.5 * (values[place - 1] + values[place]) + MARGIN).collect()
}

/// Sum of the residual over rows, and their number.
#[derive(Clone, Copy, Default)]
struct ResidualSum {
    residual: f64,
    rows: f64,
}

impl ResidualSum {
    /// How much less the squared residual is if the rows are a leaf, but for a constant.
    fn gain(self) -> f64 {
        self.residual * self.residual / (self.rows + L2)
    }

    fn minus(self, other: Self) -> Self {
        Self { residual: self.residual - other.residual, rows: self.rows - other.rows }
    }
}

/// Sums of the bins of each column, shape `[columns, BINS]`, over the rows of a node.
struct NodeHistogram(Vec<ResidualSum>);

struct Split {
    column: usize,
    /// The last bin of the first side.
    bin: usize,
}

impl NodeHistogram {
    fn total(&self) -> ResidualSum {
        self.0[..BINS].iter().fold(ResidualSum::default(), |sum, bin| ResidualSum {
            residual: sum.residual + bin.residual,
            rows: sum.rows + bin.rows,
        })
    }

    /// Value of a leaf before shrinkage.
    fn value(&self) -> f64 {
        let ResidualSum { residual, rows } = self.total();
        residual / (rows + L2)
    }

    /// The split that gains most, unless none gains anything.
    fn best_split(&self, binned: &BinnedInputs) -> Option<Split> {
        let total = self.total();
        let (mut best, mut most) = (None, total.gain() + 1e-12);
        for (column, (sums, edges)) in self.0.chunks_exact(BINS).zip(&binned.edges).enumerate() {
            let mut first = ResidualSum::default();
            for (bin, sum) in sums.iter().enumerate().take(edges.len()) {
                first = ResidualSum { residual: first.residual + sum.residual, rows: first.rows + sum.rows };
                let second = total.minus(first);
                if first.rows < 1.0 || second.rows < 1.0 {
                    continue;
                }
                let gain = first.gain() + second.gain();
                if gain > most {
                    (best, most) = (Some(Split { column, bin }), gain);
                }
            }
        }
        best
    }
}

/// A node whose rows, a stretch of the order, are not divided yet.
struct Open {
    node: usize,
    first: usize,
    end: usize,
    histogram: NodeHistogram,
}

impl Open {
    /// The two below, the first of which has the position `below`, and whose rows end at `middle`.
    fn divided(self, binned: &BinnedInputs, residual: &[f64], order: &[u32], [below, middle]: [usize; 2]) -> [Self; 2] {
        let is_first_smaller = middle - self.first <= self.end - middle;
        let smaller = if is_first_smaller { self.first..middle } else { middle..self.end };
        let smaller = binned.histogram(&order[smaller], residual);
        let mut larger = self.histogram;
        larger.0.iter_mut().zip(&smaller.0).for_each(|(sum, other)| *sum = sum.minus(*other));
        let [first, second] = if is_first_smaller { [smaller, larger] } else { [larger, smaller] };
        [
            Self { node: below, first: self.first, end: middle, histogram: first },
            Self { node: below + 1, first: middle, end: self.end, histogram: second },
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{formula_at, r2, wavy_rows};

    #[test]
    fn more_trees_fit_the_rows_better() {
        let rows = wavy_rows(300);
        let quality =
            |trees| r2(&GradientBoosting { trees, ..GradientBoosting::default() }.fit(&rows, 1).unwrap(), &rows, 0);
        let (one, ten, hundred) = (quality(1), quality(10), quality(100));
        assert!(one < ten && ten < hundred && hundred > 0.99, "{one} {ten} {hundred}");
    }

    /// smartcore tries every value of every row, so that with a bin for each value both have the same splits.
    #[test]
    fn with_few_values_the_trees_are_those_of_an_exact_search() {
        use crate::svr::matrix;
        use smartcore::xgboost::xgb_regressor::{XGRegressor, XGRegressorParameters};
        let rows = wavy_rows(200);
        let x = matrix(rows.len(), rows.inputs, rows.x.clone()).unwrap();
        let options = GradientBoosting { trees: 3, depth: 4, ..GradientBoosting::default() };
        let fitted = options.fit(&rows, 1).unwrap();
        for output in 0..rows.outputs {
            let parameters = XGRegressorParameters::default()
                .with_n_estimators(options.trees)
                .with_max_depth(options.depth)
                .with_learning_rate(options.learning_rate)
                .with_base_score(0.0);
            let exact = XGRegressor::fit(&x, &rows.output(output), parameters).unwrap().predict(&x).unwrap();
            for (row, exact) in exact.iter().enumerate() {
                let found = formula_at(&fitted, &rows, row)[output];
                assert!((found - exact).abs() < 1e-9, "row {row}: {found} {exact}");
            }
        }
    }

    #[test]
    fn bins_have_about_as_many_rows_each_and_equal_values_are_in_one() {
        let edges_of = |value: fn(usize) -> f64, count| edges((0..count).map(value).collect());
        assert_eq!(edges_of(|row| (row % 3) as f64, 30), [0.5 + MARGIN, 1.5 + MARGIN]);
        assert!(edges_of(|_| 7.0, 30).is_empty());
        let many = edges_of(|row| row as f64, 10_000);
        assert_eq!(many.len(), BINS - 1);
        assert!(many.windows(2).all(|two| [39.0, 40.0].contains(&(two[1] - two[0]).round())), "{many:?}");
    }
}

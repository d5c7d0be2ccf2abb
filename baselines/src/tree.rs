//! Decision trees, and forests of them.

use crate::{Baseline, BaselineError, Fitted, StandardizedRows, for_each_output, svr::matrix};
use metafmu_core::study::baselines::{DecisionTree, ExtraTrees, RandomForest};
use metafmu_runtime::graph::{Forest, Graph, LEAF, Node, Tree};
use serde::{Deserialize, Serialize};
use smartcore::{
    ensemble::{
        extra_trees_regressor::{ExtraTreesRegressor, ExtraTreesRegressorParameters},
        random_forest_regressor::{RandomForestRegressor, RandomForestRegressorParameters},
    },
    linalg::basic::matrix::DenseMatrix,
    tree::decision_tree_regressor::{DecisionTreeRegressor, DecisionTreeRegressorParameters},
};

impl Baseline for DecisionTree {
    fn most_rows(&self) -> Option<usize> {
        Some(self.rows)
    }

    fn fit(&self, rows: &StandardizedRows, seed: u64) -> Result<Fitted, BaselineError> {
        let mut parameters = DecisionTreeRegressorParameters::default().with_min_samples_leaf(self.leaf);
        parameters.seed = Some(seed);
        fit(rows, |x, y| {
            let fitted = DecisionTreeRegressor::fit(x, y, parameters.clone()).map_err(BaselineError::library)?;
            let SerializedRegressor { tree_regressor } = through_text(&fitted)?;
            Ok(vec![tree_regressor])
        })
    }
}

impl Baseline for RandomForest {
    fn most_rows(&self) -> Option<usize> {
        Some(self.rows)
    }

    fn fit(&self, rows: &StandardizedRows, seed: u64) -> Result<Fitted, BaselineError> {
        let parameters = RandomForestRegressorParameters::default()
            .with_n_trees(self.trees)
            .with_min_samples_leaf(self.leaf)
            .with_m(rows.inputs)
            .with_seed(seed);
        fit(rows, |x, y| {
            let fitted = RandomForestRegressor::fit(x, y, parameters.clone()).map_err(BaselineError::library)?;
            let SerializedForest { forest_regressor } = through_text(&fitted)?;
            Ok(forest_regressor.trees)
        })
    }
}

impl Baseline for ExtraTrees {
    fn most_rows(&self) -> Option<usize> {
        Some(self.rows)
    }

    fn fit(&self, rows: &StandardizedRows, seed: u64) -> Result<Fitted, BaselineError> {
        let parameters = ExtraTreesRegressorParameters::default()
            .with_n_trees(self.trees)
            .with_min_samples_leaf(self.leaf)
            .with_m(rows.inputs)
            .with_seed(seed);
        fit(rows, |x, y| {
            let fitted = ExtraTreesRegressor::fit(x, y, parameters.clone()).map_err(BaselineError::library)?;
            let SerializedForest { forest_regressor } = through_text(&fitted)?;
            Ok(forest_regressor.trees)
        })
    }
}

/// Fields of smartcore's serialized trees: in the library itself they are private.
#[derive(Deserialize)]
struct SerializedTree {
    nodes: Vec<SerializedNode>,
}

#[derive(Deserialize)]
struct SerializedNode {
    output: f64,
    split_feature: u32,
    split_value: Option<f64>,
    true_child: Option<usize>,
    false_child: Option<usize>,
}

#[derive(Deserialize)]
struct SerializedRegressor {
    tree_regressor: SerializedTree,
}

#[derive(Deserialize)]
struct SerializedForest {
    forest_regressor: SerializedTrees,
}

#[derive(Deserialize)]
struct SerializedTrees {
    trees: Vec<SerializedTree>,
}

fn through_text<T: for<'a> Deserialize<'a>>(fitted: &impl Serialize) -> Result<T, BaselineError> {
    let text = serde_json::to_vec(fitted).map_err(BaselineError::library)?;
    serde_json::from_slice(&text).map_err(BaselineError::library)
}

/// Fits the trees of each output; the model is their mean.
fn fit(
    rows: &StandardizedRows,
    fit: impl Fn(&DenseMatrix<f64>, &Vec<f64>) -> Result<Vec<SerializedTree>, BaselineError> + Send + Sync,
) -> Result<Fitted, BaselineError> {
    let x = matrix(rows.len(), rows.inputs, rows.x.clone())?;
    let fitted = for_each_output(rows, |output| fit(&x, &rows.output(output)))?;
    drop(x);
    let mut forest = Forest::default();
    for (output, trees) in (0..).zip(fitted) {
        let share = 1.0 / trees.len() as f64;
        for tree in trees {
            let root = u32::try_from(forest.nodes.len()).map_err(BaselineError::too_many_nodes)?;
            forest.trees.push(Tree { root, output });
            append(&mut forest.nodes, &tree, share)?;
        }
    }
    Ok(Fitted::Formula(Graph::of_forest(&rows.scaling, forest)))
}

/// Offset of each split from the middle between two values of the rows. The middle is often a value of other rows, such
/// as a time. A time that a host has accumulated step by step exceeds it by rounding and must not fall on the other
/// side.
pub(crate) const MARGIN: f64 = 1e-9;

/// Puts the nodes of a tree, whose leaves are multiplied by its share, behind the others: depth first.
fn append(nodes: &mut Vec<Node>, tree: &SerializedTree, share: f64) -> Result<(), BaselineError> {
    // a node of the tree, and where its position belongs
    let mut waiting: Vec<(usize, Option<(usize, usize)>)> = vec![(0, None)];
    while let Some((index, from)) = waiting.pop() {
        let node = tree.nodes.get(index).ok_or_else(|| BaselineError::library("a tree without a root"))?;
        let position = nodes.len();
        if let Some((above, side)) = from {
            nodes[above].below[side] = u32::try_from(position).map_err(BaselineError::too_many_nodes)?;
        }
        let split = node.split_value.zip(node.true_child.zip(node.false_child));
        nodes.push(match split {
            Some((number, _)) => Node { column: node.split_feature, number: number + MARGIN, below: [0; 2] },
            None => Node { column: LEAF, number: node.output * share, below: [0; 2] },
        });
        if let Some((_, (yes, no))) = split {
            waiting.extend([(no, Some((position, 1))), (yes, Some((position, 0)))]);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{formula_at, r2, wavy_rows};

    #[track_caller]
    fn assert_same(fitted: &Fitted, rows: &StandardizedRows, output: usize, predicted: &[f64]) {
        for (row, predicted) in predicted.iter().enumerate() {
            let found = formula_at(fitted, rows, row)[output];
            assert!((found - predicted).abs() < 1e-9, "row {row}: {found} {predicted}");
        }
    }

    #[test]
    fn the_formulas_are_the_librarys_own_predictions() {
        let rows = wavy_rows(500);
        let x = matrix(rows.len(), rows.inputs, rows.x.clone()).unwrap();
        for output in 0..rows.outputs {
            let y = rows.output(output);
            let mut parameters = DecisionTreeRegressorParameters::default().with_min_samples_leaf(2);
            parameters.seed = Some(1);
            let tree = DecisionTreeRegressor::fit(&x, &y, parameters).unwrap();
            assert_same(&DecisionTree::default().fit(&rows, 1).unwrap(), &rows, output, &tree.predict(&x).unwrap());

            let parameters = RandomForestRegressorParameters::default().with_n_trees(7).with_min_samples_leaf(3);
            let forest = RandomForestRegressor::fit(&x, &y, parameters.with_m(3).with_seed(5)).unwrap();
            let ours = RandomForest { trees: 7, leaf: 3, ..RandomForest::default() }.fit(&rows, 5).unwrap();
            assert_same(&ours, &rows, output, &forest.predict(&x).unwrap());

            let parameters = ExtraTreesRegressorParameters::default().with_n_trees(7).with_min_samples_leaf(3);
            let forest = ExtraTreesRegressor::fit(&x, &y, parameters.with_m(3).with_seed(5)).unwrap();
            let ours = ExtraTrees { trees: 7, leaf: 3, ..ExtraTrees::default() }.fit(&rows, 5).unwrap();
            assert_same(&ours, &rows, output, &forest.predict(&x).unwrap());
        }
    }

    #[test]
    fn a_tree_whose_leaves_are_single_rows_gives_the_rows_back() {
        let rows = wavy_rows(300);
        let fitted = DecisionTree { leaf: 1, ..DecisionTree::default() }.fit(&rows, 1).unwrap();
        assert!(r2(&fitted, &rows, 0) > 1.0 - 1e-12);
    }

    #[test]
    fn the_same_seed_gives_the_same_forest_and_another_one_another() {
        let rows = wavy_rows(300);
        let predictions = |seed| formula_at(&RandomForest::default().fit(&rows, seed).unwrap(), &rows, 7);
        assert_eq!(predictions(1), predictions(1));
        assert_ne!(predictions(1), predictions(2));
    }
}

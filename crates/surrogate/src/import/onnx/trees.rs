//! `ai.onnx.ml.TreeEnsembleRegressor`: decision trees, random forests, gradient boosting.

use super::{
    GraphReader, ImportError,
    attributes::Attributes,
    node::{RowTensor, Value},
    proto::NodeProto,
};
use metafmu_runtime::graph::{Elementwise, Forest, LEAF, Node, Step, Tree};
use std::{collections::HashMap, sync::Arc};

/// Nodes of all trees together, each once for every output that it adds to.
const MAX_NODES: usize = 1 << 24;
/// Nodes of all trees together for several rows.
const MAX_NODES_OF_ROWS: usize = 1 << 21;

/// A node as the file has it.
struct TreeNode {
    column: usize,
    threshold: f64,
    comparison: BranchMode,
    below: [i64; 2],
}

/// Mode of a node: the test that chooses the branch.
#[derive(Clone, Copy, PartialEq)]
enum BranchMode {
    Leaf,
    /// The first one if the input is at most the threshold.
    AtMost,
    /// The first one if it is less.
    Less,
    /// The second one if it is at most the threshold.
    More,
    /// The second one if it is less.
    AtLeast,
}

impl GraphReader {
    pub fn tree_ensemble(&mut self, node: &NodeProto) -> Result<Value, ImportError> {
        let attributes = Attributes::of(node);
        let shape = self.row(node, 0)?.shape;
        let columns = shape.last().copied().unwrap_or(1);
        let (share, mut base) =
            (attributes.text("aggregate_function").unwrap_or("SUM".into()), attributes.numbers("base_values")?.values);
        refuse_transform(attributes)?;
        let outputs = usize::try_from(attributes.integer("n_targets").unwrap_or(1)).unwrap_or(0);
        match outputs {
            0 => return Err(ImportError::malformed("0 targets")),
            _ if outputs > MAX_NODES => return Err(ImportError::too_large(format!("{outputs} targets"))),
            _ => {}
        }
        let (nodes, trees) = given_nodes(attributes, columns)?;
        let leaves = leaves(attributes, outputs)?;
        let scale = match share.as_str() {
            "SUM" => 1.0,
            "AVERAGE" => 1.0 / trees.len().max(1) as f64,
            other => {
                return Err(ImportError::unsupported(format!("aggregate function {other}, expected SUM or AVERAGE")));
            }
        };
        if base.len() == 1 {
            base = vec![base[0]; outputs];
        }
        if !base.is_empty() && base.len() != outputs {
            return Err(ImportError::malformed(format!("{} base values, expected {outputs}", base.len())));
        }
        let forest = Arc::new(forest(&nodes, &trees, &leaves, (outputs, scale))?);
        // each row has the trees once more
        let rows = shape.iter().product::<usize>().checked_div(columns).unwrap_or(0);
        if rows > 1 && rows.saturating_mul(forest.nodes.len()) > MAX_NODES_OF_ROWS {
            return Err(ImportError::too_large(format!(
                "{} nodes of trees for each of {rows} rows, expected at most {MAX_NODES_OF_ROWS} in all",
                forest.nodes.len()
            )));
        }
        self.each_row(node, outputs, |reader, row| {
            // thresholds lie between two singles, so the compared values must be singles
            let row = if row.is_single { reader.rounded(row.clone())? } else { row.clone() };
            let step = Step::Forest { of: row.value, forest: forest.clone(), outputs };
            let value = reader.builder.add(step, outputs)?;
            let value = Value::Row(RowTensor { shape: vec![1, outputs], value, is_single: row.is_single });
            match base.as_slice() {
                [] => Ok(value),
                base => reader.mapped(&value, Elementwise::Linear, [&vec![1.0; outputs], base].concat()),
            }
        })
    }
}

/// Only what regressors have.
pub fn refuse_transform(attributes: Attributes) -> Result<(), ImportError> {
    match attributes.text("post_transform").as_deref() {
        None | Some("NONE") => Ok(()),
        Some(other) => Err(ImportError::unsupported(format!("post_transform {other}, expected NONE"))),
    }
}

type Key = (i64, i64);

/// The nodes by tree and number, and the trees with their first nodes.
fn given_nodes(attributes: Attributes, columns: usize) -> Result<(HashMap<Key, TreeNode>, Vec<Key>), ImportError> {
    let (trees, ids) = (
        attributes.integers("nodes_treeids").unwrap_or_default(),
        attributes.integers("nodes_nodeids").unwrap_or_default(),
    );
    let (first, second) = (
        attributes.integers("nodes_truenodeids").unwrap_or_default(),
        attributes.integers("nodes_falsenodeids").unwrap_or_default(),
    );
    let features = attributes.integers("nodes_featureids").unwrap_or_default();
    let modes = attributes.texts("nodes_modes");
    let thresholds = attributes.numbers("nodes_values")?;
    let count = ids.len();
    let lengths = [trees.len(), first.len(), second.len(), features.len(), modes.len(), thresholds.values.len()];
    if count == 0 || lengths.iter().any(|length| *length != count) {
        return Err(ImportError::malformed(format!(
            "nodes_* attributes of {count} and {lengths:?} elements, expected the same number of each"
        )));
    }
    let (mut nodes, mut roots) = (HashMap::new(), Vec::<Key>::new());
    for place in 0..count {
        let key = (trees[place], ids[place]);
        let comparison = match modes[place].as_str() {
            "LEAF" => BranchMode::Leaf,
            "BRANCH_LEQ" => BranchMode::AtMost,
            "BRANCH_LT" => BranchMode::Less,
            "BRANCH_GT" => BranchMode::More,
            "BRANCH_GTE" => BranchMode::AtLeast,
            other => {
                return Err(ImportError::unsupported(format!(
                    "a node of mode {other}, expected LEAF, BRANCH_LEQ, BRANCH_LT, BRANCH_GT or BRANCH_GTE"
                )));
            }
        };
        let column = usize::try_from(features[place]).unwrap_or(usize::MAX);
        if comparison != BranchMode::Leaf && column >= columns {
            return Err(ImportError::malformed(format!(
                "node {} of tree {} looks at feature {}, of {columns}",
                key.1, key.0, features[place]
            )));
        }
        let threshold = thresholds.values[place];
        let threshold = match comparison {
            // the largest number that is less than the threshold, in the precision of the inputs
            BranchMode::Less | BranchMode::AtLeast => match thresholds.is_single {
                true => f64::from((threshold as f32).next_down()),
                false => threshold.next_down(),
            },
            _ => threshold,
        };
        let given = TreeNode { column, threshold, comparison, below: [first[place], second[place]] };
        if nodes.insert(key, given).is_some() {
            return Err(ImportError::malformed(format!("two nodes {} of tree {}", key.1, key.0)));
        }
        // the first node of a tree that is listed is its root
        if roots.last().is_none_or(|(tree, _)| *tree != key.0) {
            if roots.iter().any(|(tree, _)| *tree == key.0) {
                return Err(ImportError::malformed(format!("nodes of tree {} in several places", key.0)));
            }
            roots.push(key);
        }
    }
    Ok((nodes, roots))
}

/// Numbers that each leaf adds to outputs.
fn leaves(attributes: Attributes, outputs: usize) -> Result<HashMap<Key, Vec<(usize, f64)>>, ImportError> {
    let (trees, ids, targets) = (
        attributes.integers("target_treeids").unwrap_or_default(),
        attributes.integers("target_nodeids").unwrap_or_default(),
        attributes.integers("target_ids").unwrap_or_default(),
    );
    let weights = attributes.numbers("target_weights")?.values;
    let lengths = [ids.len(), targets.len(), weights.len()];
    if lengths.iter().any(|length| *length != trees.len()) {
        return Err(ImportError::malformed(format!(
            "target_* attributes of {} and {lengths:?} elements, expected the same number of each",
            trees.len()
        )));
    }
    let mut leaves: HashMap<Key, Vec<(usize, f64)>> = HashMap::new();
    for (((tree, id), target), weight) in trees.iter().zip(ids).zip(targets).zip(weights) {
        let output = usize::try_from(*target).ok().filter(|output| *output < outputs);
        let output = output.ok_or_else(|| ImportError::malformed(format!("target {target} of {outputs}")))?;
        leaves.entry((*tree, *id)).or_default().push((output, weight));
    }
    Ok(leaves)
}

fn forest(
    nodes: &HashMap<Key, TreeNode>,
    roots: &[Key],
    leaves: &HashMap<Key, Vec<(usize, f64)>>,
    (outputs, scale): (usize, f64),
) -> Result<Forest, ImportError> {
    let mut forest = Forest::default();
    for root in roots {
        for output in 0..outputs {
            let tree = Tree { root: forest.nodes.len() as u32, output: output as u32 };
            // node by node, each before those below it: the node that points at it, and on which side
            let mut waiting: Vec<(i64, Option<(usize, usize)>)> = vec![(root.1, None)];
            let begin = forest.nodes.len();
            while let Some((id, above)) = waiting.pop() {
                let given = nodes
                    .get(&(root.0, id))
                    .ok_or_else(|| ImportError::malformed(format!("no node {id} in tree {}", root.0)))?;
                let place = forest.nodes.len();
                if place - begin > nodes.len() {
                    return Err(ImportError::malformed(format!("tree {} has a cycle", root.0)));
                }
                if place >= MAX_NODES {
                    return Err(ImportError::too_large(format!("more than {MAX_NODES} nodes")));
                }
                if let Some((above, side)) = above {
                    forest.nodes[above].below[side] = place as u32;
                }
                if given.comparison == BranchMode::Leaf {
                    let added = leaves.get(&(root.0, id)).into_iter().flatten();
                    let number: f64 = added.filter(|(to, _)| *to == output).map(|(_, weight)| weight).sum();
                    forest.nodes.push(Node { column: LEAF, number: scale * number, below: [0; 2] });
                    continue;
                }
                forest.nodes.push(Node { column: given.column as u32, number: given.threshold, below: [0; 2] });
                let [mut first, mut second] = given.below;
                if matches!(given.comparison, BranchMode::More | BranchMode::AtLeast) {
                    std::mem::swap(&mut first, &mut second);
                }
                waiting.push((second, Some((place, 1))));
                waiting.push((first, Some((place, 0))));
            }
            forest.trees.push(tree);
        }
    }
    Ok(forest)
}

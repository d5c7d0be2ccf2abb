//! Sums of decision trees.

use crate::{
    FormatError,
    check::{expect_below, expect_finite},
};

/// In place of an input column: the node is a leaf.
pub const LEAF: u32 = u32::MAX;

/// `y_o`: the sum over the trees of output `o` of the leaf that the inputs lead to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Forest {
    /// Nodes of all trees; those below a node come after it.
    pub nodes: Vec<Node>,
    /// The trees.
    pub trees: Vec<Tree>,
}

/// A split or a leaf.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Input of a split, or [`LEAF`].
    pub column: u32,
    /// Threshold of a split: inputs up to it go to the first node below, others to the second. Value of a leaf.
    pub number: f64,
    /// Positions of the nodes below a split; 0 at a leaf.
    pub below: [u32; 2],
}

/// Root of a tree and the output that it adds to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tree {
    /// Position of its first node.
    pub root: u32,
    /// Output column.
    pub output: u32,
}

impl Forest {
    pub(super) fn check(&self, inputs: usize, outputs: usize) -> Result<(), FormatError> {
        expect_finite("forest.number", self.nodes.iter().map(|node| node.number))?;
        for (position, node) in self.nodes.iter().enumerate().filter(|(_, node)| node.column != LEAF) {
            expect_below(&"forest.column", position, node.column as usize, inputs)?;
            for (side, &below) in node.below.iter().enumerate() {
                expect_below(&"forest.below", 2 * position + side, below as usize, self.nodes.len())?;
                // else a walk down the tree might never end
                if below as usize <= position {
                    return Err(FormatError::Upwards { node: position, below });
                }
            }
        }
        for (index, tree) in self.trees.iter().enumerate() {
            expect_below(&"forest.root", index, tree.root as usize, self.nodes.len())?;
            expect_below(&"forest.output", index, tree.output as usize, outputs)?;
        }
        Ok(())
    }

    /// Calls back with an output and what a tree adds to it, for each tree.
    pub(super) fn evaluate(&self, input: impl Fn(usize) -> f64, mut add: impl FnMut(usize, f64)) {
        for tree in &self.trees {
            let mut node = &self.nodes[tree.root as usize];
            while node.column != LEAF {
                // a NaN goes to the second node, as in smartcore
                let first = input(node.column as usize) <= node.number;
                node = &self.nodes[node.below[usize::from(!first)] as usize];
            }
            add(tree.output as usize, node.number);
        }
    }
}

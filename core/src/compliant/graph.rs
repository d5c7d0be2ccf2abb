//! A compliant element as a graph of steps, which the FMU's library evaluates with its derivatives.

use super::{CompliantElement, triangle};
use metafmu_runtime::{
    Graph,
    graph::{Operation, Products, Step},
};

impl CompliantElement {
    /// Forces as functions of parameters, positions and velocities. The dissipation is computed as `L (Lᵀ v)`: its power is a sum of squares
    /// but for rounding.
    pub fn graph(&self) -> Graph {
        let (n, configuration) = (self.coordinates, self.parameters + self.coordinates);
        let velocity = |coordinate: usize| [0, (configuration + coordinate) as u32];
        let mut graph = Steps { steps: Vec::new() };
        let columns = (0..configuration as u32).map(|column| [0, column]).collect();
        let mut z = 0;
        if self.has_velocities {
            z = graph.add(Step::Columns { columns });
        }
        z = graph.add(Step::Standardize { of: z, mean: self.middle.clone(), scale: self.half.clone() });
        let terms = self.potential.len().max(self.products_of_entry());
        let degrees = self.basis.products.degrees[..terms * configuration].to_vec();
        let products = graph.add(Step::Products { of: z, products: Products { inputs: configuration, degrees } });
        let entries: Vec<(usize, usize)> = triangle(n).take(self.entries()).collect();
        let mut weight = vec![0.0; (n + entries.len()) * terms];
        for (coordinate, row) in weight.chunks_mut(terms).take(n).enumerate() {
            let column = self.parameters + coordinate;
            for (product, coefficient) in self.potential.iter().enumerate() {
                for (place, factor) in self.basis.derivative(column, product) {
                    row[*place] += coefficient * factor / self.half[column];
                }
            }
        }
        let of_entries = weight.chunks_mut(terms).skip(n).zip(self.dissipation.chunks(self.products_of_entry().max(1)));
        for ((row, coefficients), (coordinate, _)) in of_entries.zip(&entries) {
            let half = self.half[self.parameters + coordinate];
            row.iter_mut().zip(coefficients).for_each(|(weight, coefficient)| *weight = coefficient / half);
        }
        let bias = vec![0.0; n + entries.len()];
        let functions = graph.add(Step::Affine { of: products, weight: weight.into(), bias: bias.into() });
        if !entries.is_empty() {
            let entry = |index: usize| [functions as u32, (n + index) as u32];
            let l = graph.columns((0..entries.len()).map(entry));
            let v = graph.columns(entries.iter().map(|(row, _)| velocity(*row)));
            let parts = graph.combined([l, v], Operation::Multiply);
            // Lᵀ v
            let rates = graph.sums(parts, n, entries.iter().map(|(_, column)| *column));
            let rates = graph.columns(entries.iter().map(|(_, column)| [rates as u32, *column as u32]));
            let parts = graph.combined([l, rates], Operation::Multiply);
            let damping = graph.sums(parts, n, entries.iter().map(|(row, _)| *row));
            let elastic = graph.columns((0..n as u32).map(|coordinate| [functions as u32, coordinate]));
            graph.combined([elastic, damping], Operation::Add);
        }
        let inputs = configuration + if self.has_velocities { n } else { 0 };
        Graph { inputs, steps: graph.steps }
    }
}

/// Steps of a graph under construction.
struct Steps {
    steps: Vec<Step>,
}

impl Steps {
    /// Index of the value that the step makes.
    fn add(&mut self, step: Step) -> usize {
        self.steps.push(step);
        self.steps.len()
    }

    fn columns(&mut self, columns: impl Iterator<Item = [u32; 2]>) -> usize {
        self.add(Step::Columns { columns: columns.collect() })
    }

    fn combined(&mut self, of: [usize; 2], operation: Operation) -> usize {
        self.add(Step::Combine { of, operation })
    }

    /// Sums of numbers by the row to which each belongs.
    fn sums(&mut self, of: usize, rows: usize, row_of: impl ExactSizeIterator<Item = usize>) -> usize {
        let numbers = row_of.len();
        let mut weight = vec![0.0; rows * numbers];
        row_of.enumerate().for_each(|(number, row)| weight[row * numbers + number] = 1.0);
        self.add(Step::Affine { of, weight: weight.into(), bias: vec![0.0; rows].into() })
    }
}

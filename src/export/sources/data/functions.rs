//! Functions that were learned: dictionaries, and networks that add to them.

use super::{
    array,
    network::{activation, in_blocks, padded, padded_to_block},
    operations::Operations,
    push, real, table,
};
use metafmu_runtime::{
    Activation, ScaledNetwork,
    dictionary::{self, Dictionary, Factor},
    law::{ColumnKind, NetworkColumn, NetworkTerm},
};

/// A dictionary as the C code has it.
pub(super) struct Laid {
    pub outputs: usize,
    pub columns: Vec<FactorColumn>,
    pub products: Vec<ProductTerm>,
}

pub(super) struct FactorColumn {
    pub factor: Factor,
    /// Multiples or powers that are computed: 1 to this.
    pub orders: usize,
}

pub(super) struct ProductTerm {
    /// Column and atom.
    pub factors: Vec<(usize, usize)>,
    /// Output and coefficient.
    pub coefficients: Vec<(usize, f64)>,
}

impl FactorColumn {
    fn atoms(&self) -> usize {
        if self.factor == Factor::Angle { 2 * self.orders } else { self.orders }
    }
}

impl Laid {
    pub fn out(dictionary: &Dictionary) -> Self {
        let terms: Vec<dictionary::Term> = dictionary.terms().collect();
        let orders = |column: usize| terms.iter().map(|term| term.exponents[column].unsigned_abs()).max();
        let column = |(index, factor)| FactorColumn { factor, orders: orders(index).unwrap_or(0).into() };
        let columns: Vec<FactorColumn> = dictionary.factors().enumerate().map(column).collect();
        let first = |column: usize| columns[..column].iter().map(FactorColumn::atoms).sum::<usize>();
        let product = |term: &dictionary::Term| {
            let present = term.exponents.iter().copied().enumerate().filter(|(_, exponent)| *exponent != 0);
            let factor = |(column, exponent): (usize, i16)| {
                let order = usize::from(exponent.unsigned_abs()) - 1;
                let within = match columns[column].factor {
                    Factor::Angle => 2 * order + usize::from(exponent < 0),
                    Factor::Power { .. } => order,
                };
                (column, first(column) + within)
            };
            let coefficients = term.coefficients.iter().copied().enumerate().filter(|(_, value)| *value != 0.0);
            ProductTerm { factors: present.map(factor).collect(), coefficients: coefficients.collect() }
        };
        let products = terms.iter().map(product).collect();
        Self { outputs: dictionary.outputs(), products, columns }
    }

    /// Functions of the columns.
    pub fn atoms(&self) -> usize {
        self.columns.iter().map(FactorColumn::atoms).sum()
    }

    /// Columns of which a sine and a cosine are computed.
    pub fn angles(&self) -> usize {
        self.columns.iter().filter(|column| column.factor == Factor::Angle && column.orders > 0).count()
    }

    /// Multiplications, additions and divisions of an evaluation with derivatives with respect to so many columns, the first ones; the
    /// formula is in `motion.c`.
    pub fn operations(&self, derivatives: usize) -> usize {
        let of_column = |FactorColumn { factor, orders }: &FactorColumn| match factor {
            _ if *orders == 0 => 0,
            Factor::Angle => 8 * orders,
            Factor::Power { .. } => 3 * orders + 2,
        };
        let of_product = |ProductTerm { factors, coefficients }: &ProductTerm| {
            let derived = factors.iter().filter(|(column, _)| *column < derivatives).count();
            let (f, c) = (factors.len(), coefficients.len());
            f + 2 * c + derived * (f.saturating_sub(1) + 2 * c)
        };
        self.columns.iter().map(of_column).chain(self.products.iter().map(of_product)).sum()
    }

    pub fn write(&self, text: &mut String, name: &str) {
        let columns = self.columns.iter().map(|FactorColumn { factor, orders }| match factor {
            Factor::Angle => format!("true, 0.0, 0.0, {orders}"),
            Factor::Power { middle, half } => format!("false, {}, {}, {orders}", real(*middle), real(half.recip())),
        });
        table(text, &format!("static const DictionaryColumn {name}_columns"), columns, "false, 0.0, 0.0, 0");
        let products = self
            .products
            .iter()
            .map(|ProductTerm { factors, coefficients }| format!("{}, {}", factors.len(), coefficients.len()));
        table(text, &format!("static const Product {name}_products"), products, "0, 0");
        let factors = self.products.iter().flat_map(|product| &product.factors);
        let factors = factors.map(|(column, atom)| format!("{column}, {atom}"));
        table(text, &format!("static const Factor {name}_factors"), factors, "0, 0");
        let coefficients = self.products.iter().flat_map(|product| &product.coefficients);
        let coefficients = coefficients.map(|(output, value)| format!("{output}, {}", real(*value)));
        table(text, &format!("static const Coefficient {name}_coefficients"), coefficients, "0, 0.0");
        let (outputs, products) = (self.outputs, self.products.len());
        push(
            text,
            format_args!(
                "\nconst Dictionary model_{name} = {{\n    \
                 {outputs}, {products}, {name}_columns, {name}_products, {name}_factors, {name}_coefficients\n}};\n"
            ),
        );
    }
}

/// A network that adds to functions of some columns.
pub(super) struct AddedNetwork<'a> {
    pub columns: Vec<NetworkColumn>,
    /// Which functions.
    pub outputs: Vec<usize>,
    pub network: &'a ScaledNetwork,
}

impl<'a> From<&'a NetworkTerm> for AddedNetwork<'a> {
    fn from(term: &'a NetworkTerm) -> Self {
        Self { columns: term.columns().into(), outputs: term.outputs().into(), network: term.network() }
    }
}

/// What an evaluation of a network takes.
#[derive(Default)]
pub(super) struct Cost {
    /// Multiplications, additions and divisions but for activations.
    pub operations: usize,
    /// Columns of which a sine and a cosine are computed.
    pub angles: usize,
    /// Activations of nodes.
    pub activations: usize,
}

impl Cost {
    /// With derivatives with respect to so many columns; the formula is in `motion.c`.
    pub fn of(term: Option<&AddedNetwork>, derivatives: usize) -> Self {
        let Some(AddedNetwork { columns, outputs, network }) = term else { return Self::default() };
        let d = derivatives;
        let layers = &network.layers;
        let active = layers.iter().filter(|layer| layer.activation != Activation::Identity);
        let activations = active.map(|layer| padded(layer.outputs)).sum();
        let products: usize = layers.iter().map(|layer| 2 * (1 + d) * layer.inputs * padded(layer.outputs)).sum();
        Self {
            operations: (2 + d) * columns.len() + products + d * activations + (3 + 2 * d) * outputs.len(),
            angles: columns.iter().filter(|column| column.kind != ColumnKind::Plain).count(),
            activations,
        }
    }
}

/// Numbers of the widest layer of some networks, in whole blocks, one at least.
pub(super) fn width<'a>(terms: impl IntoIterator<Item = &'a AddedNetwork<'a>>) -> usize {
    let layers = terms.into_iter().flat_map(|term| &term.network.layers);
    layers.map(|layer| padded(layer.outputs.max(layer.inputs))).max().unwrap_or(1)
}

/// What is said of a step: numbers of operations, of sines and cosines, and of activations of networks.
pub(super) fn remark(arithmetic: f64, sines: f64, activations: f64, file: &str) -> String {
    let operations = Operations { arithmetic, sines, activations, ..Operations::default() };
    operations.remark("A step of model_time_step takes", &format!("{file} has"))
}

/// A network that adds to functions; without layers if there is none.
pub(super) fn write_network(text: &mut String, name: &str, term: Option<&AddedNetwork>) {
    let Some(AddedNetwork { columns, outputs, network }) = term else {
        push(text, format_args!("\nconst NetworkTerm model_{name}_network = {{0, NULL, 0, NULL, 0, NULL}};\n"));
        return;
    };
    let scaling = &network.scaling;
    let kind = |kind: ColumnKind| match kind {
        ColumnKind::Plain => "TERM_PLAIN",
        ColumnKind::Sine => "TERM_OF_SINE",
        ColumnKind::Cosine => "TERM_OF_COSINE",
    };
    let rows = columns.iter().zip(scaling.input_mean.iter().zip(&scaling.input_scale));
    let rows = rows.map(|(column, (mean, scale))| {
        format!("{}, {}, {}, {}", column.of, kind(column.kind), real(*mean), real(scale.recip()))
    });
    table(text, &format!("static const TermColumn {name}_network_columns"), rows, "0, TERM_PLAIN, 0.0, 0.0");
    let rows = outputs.iter().zip(scaling.output_mean.iter().zip(&scaling.output_scale));
    let rows = rows.map(|(of, (mean, scale))| format!("{of}, {}, {}", real(*mean), real(*scale)));
    table(text, &format!("static const TermOutput {name}_network_outputs"), rows, "0, 0.0, 0.0");
    let layers = &network.layers;
    for (index, layer) in layers.iter().enumerate() {
        let mut weights = in_blocks(layer);
        // C has no empty arrays
        weights.resize(weights.len().max(1), 0.0);
        array(text, &format!("static const Real {name}_network_weights_{index}"), &weights);
        array(text, &format!("static const Real {name}_network_bias_{index}"), &padded_to_block(&layer.bias));
    }
    let rows = layers.iter().enumerate().map(|(index, layer)| {
        let (inputs, rows, activation) = (layer.inputs, padded(layer.outputs), activation(layer.activation));
        format!("{inputs}, {rows}, {name}_network_weights_{index}, {name}_network_bias_{index}, {activation}")
    });
    table(text, &format!("static const TermLayer {name}_network_layers"), rows, "");
    let [columns, layers, outputs] = [columns.len(), layers.len(), outputs.len()];
    push(
        text,
        format_args!(
            "\nconst NetworkTerm model_{name}_network = {{\n    {columns}, {name}_network_columns, {layers}, \
             {name}_network_layers, {outputs}, {name}_network_outputs\n}};\n"
        ),
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::{Model, example};

    #[test]
    fn operations_of_a_network_with_derivatives_are_those_of_a_count_by_hand() {
        let crane = example::crane_with_networks();
        let Model::Motion(motion) = crane.model() else { panic!("the crane moves") };
        let cost = Cost::of(motion.dynamics.law().network().map(AddedNetwork::from).as_ref(), 2);
        // four columns, two of an angle; layers of 4 to 9 to 6 to 6 in blocks of 16, of which the last is linear; six outputs
        let expected = 4 * (2 + 2) + 2 * 3 * (4 + 9 + 6) * 16 + 2 * 32 + 6 * (3 + 2 * 2);
        assert_eq!((cost.operations, cost.angles, cost.activations), (expected, 2, 32));
    }

    #[test]
    fn what_there_is_none_of_is_still_an_array() {
        let empty = Dictionary::new(&[Factor::Angle], 0, &[]).unwrap();
        let mut text = String::new();
        Laid::out(&empty).write(&mut text, "positions");
        assert!(text.contains("positions_products[] = {\n    {0, 0},\n};"), "{text}");
        assert!(text.contains("model_positions = {\n    0, 0, positions_columns"), "{text}");
    }
}

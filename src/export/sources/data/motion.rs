//! Dictionaries, windings and shown outputs of equations of motion.

use super::{Part, array, push, real};
use metafmu_runtime::{
    Activation, Motion, Shown, Surrogate,
    dictionary::{Dictionary, Factor, Term},
    law::{ColumnKind, NetworkTerm},
};

const NAMES: &[&str] = &[
    "model_forces_network",
    "model_law",
    "model_law_network",
    "model_positions",
    "model_positions_network",
    "model_shown",
    "model_solver_step",
    "model_windings",
    "motion_advance",
];

pub fn part(surrogate: &Surrogate, motion: &Motion) -> Part {
    let dynamics = &motion.dynamics;
    let (law, positions) = (Laid::out(dynamics.law().dictionary()), Laid::out(motion.positions.dictionary()));
    let (n, m) = (dynamics.coordinates(), dynamics.inputs());
    let networks = [dynamics.law().network(), dynamics.forces(), motion.positions.network()];
    let width = networks.into_iter().flatten().flat_map(|term| {
        let layers = term.network().layers.iter();
        layers.map(|layer| layer.outputs.max(layer.inputs))
    });
    let of_law = networks[0].map_or(Cost::default(), |term| Cost::of(term, n));
    let of_forces = networks[1].map_or(Cost::default(), |term| Cost::of(term, 0));
    let sub_steps = (surrogate.metadata().time_step / motion.step * (1.0 - 1e-9)).ceil().max(1.0);
    let stages = |count: usize| 4.0 * sub_steps * count as f64;
    let tangents = match of_law.tangents + of_forces.tangents {
        0 => String::new(),
        count => format!(" and {} hyperbolic\n * tangents or sines and cosines of nodes", stages(count)),
    };
    Part {
        names: NAMES,
        sizes: vec![
            ("COORDINATE_COUNT", n, ""),
            ("FIRST_DRIVEN", dynamics.parameters() + 2 * n, "the first input that is neither parameter nor start"),
            ("DICTIONARY_COLUMNS", dynamics.law().dictionary().columns(), "coordinates and parameters"),
            ("ATOM_COUNT", law.atoms().max(positions.atoms()).max(1), "functions of the columns"),
            ("NETWORK_WIDTH", width.max().unwrap_or(1), "of the widest layer of a network"),
            ("POSITION_SIZE", positions.outputs.max(1), "number of positions, but C has no empty arrays"),
        ],
        remark: format!(
            "\n/*\n * A step of model_time_step takes {} multiplications, additions and divisions, and {} sines or\n \
             * cosines{tangents}; motion.c has the formula.\n */\n",
            operations(&law, n, m, sub_steps) + stages(of_law.operations + of_forces.operations),
            stages(2 * (law.angles() + of_law.angles + of_forces.angles)),
        ),
        data: data(motion, &law, &positions),
    }
}

fn data(motion: &Motion, law: &Laid, positions: &Laid) -> String {
    let mut text = format!("\nconst double model_solver_step = {};\n", real(motion.step));
    law.write(&mut text, "law");
    positions.write(&mut text, "positions");
    let dynamics = &motion.dynamics;
    for (name, term) in
        [("law", dynamics.law().network()), ("positions", motion.positions.network()), ("forces", dynamics.forces())]
    {
        write_network(&mut text, name, term);
    }
    let mut windings = motion.windings.clone();
    // C has no empty arrays
    windings.resize(windings.len().max(motion.dynamics.coordinates()), 0.0);
    array(&mut text, "const double model_windings", &windings);
    text.push_str("\nconst Shown model_shown[OUTPUT_COUNT] = {\n");
    for shown in &motion.outputs {
        let (kind, position) = match *shown {
            Shown::Position(position) => ("POSITION", position),
            Shown::Velocity(position) => ("VELOCITY", position),
            Shown::Acceleration(position) => ("ACCELERATION", position),
            Shown::KineticEnergy => ("KINETIC_ENERGY", 0),
            Shown::PotentialEnergy => ("POTENTIAL_ENERGY", 0),
        };
        push(&mut text, format_args!("    {{SHOWN_{kind}, {position}}},\n"));
    }
    text.push_str("};\n");
    text
}

/// A dictionary as the C code has it.
struct Laid {
    outputs: usize,
    columns: Vec<Column>,
    products: Vec<Product>,
}

struct Column {
    factor: Factor,
    /// Multiples or powers that are computed: 1 to this.
    orders: usize,
}

struct Product {
    /// Column and atom.
    factors: Vec<(usize, usize)>,
    /// Output and coefficient.
    coefficients: Vec<(usize, f64)>,
}

impl Column {
    fn atoms(&self) -> usize {
        if self.factor == Factor::Angle { 2 * self.orders } else { self.orders }
    }
}

impl Laid {
    fn out(dictionary: &Dictionary) -> Self {
        let terms: Vec<Term> = dictionary.terms().collect();
        let orders = |column: usize| terms.iter().map(|term| term.exponents[column].unsigned_abs()).max();
        let column = |(index, factor)| Column { factor, orders: orders(index).unwrap_or(0).into() };
        let columns: Vec<Column> = dictionary.factors().enumerate().map(column).collect();
        let first = |column: usize| columns[..column].iter().map(Column::atoms).sum::<usize>();
        let product = |term: &Term| {
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
            Product { factors: present.map(factor).collect(), coefficients: coefficients.collect() }
        };
        let products = terms.iter().map(product).collect();
        Self { outputs: dictionary.outputs(), products, columns }
    }

    /// Functions of the columns.
    fn atoms(&self) -> usize {
        self.columns.iter().map(Column::atoms).sum()
    }

    /// Columns of which a sine and a cosine are computed.
    fn angles(&self) -> usize {
        self.columns.iter().filter(|column| column.factor == Factor::Angle && column.orders > 0).count()
    }

    fn write(&self, text: &mut String, name: &str) {
        let columns = self.columns.iter().map(|Column { factor, orders }| match factor {
            Factor::Angle => format!("true, 0.0, 0.0, {orders}"),
            Factor::Power { middle, half } => format!("false, {}, {}, {orders}", real(*middle), real(half.recip())),
        });
        table(text, &format!("static const DictionaryColumn {name}_columns"), columns, "false, 0.0, 0.0, 0");
        let products = self
            .products
            .iter()
            .map(|Product { factors, coefficients }| format!("{}, {}", factors.len(), coefficients.len()));
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

/// What a stage of a step takes for a network.
#[derive(Default)]
struct Cost {
    /// Multiplications, additions and divisions.
    operations: usize,
    /// Columns of which a sine and a cosine are computed.
    angles: usize,
    /// Nodes with an activation.
    tangents: usize,
}

impl Cost {
    /// With derivatives with respect to so many columns; the formula is in `motion.c`.
    fn of(term: &NetworkTerm, derivatives: usize) -> Self {
        let d = derivatives;
        let layers = &term.network().layers;
        let active = layers.iter().filter(|layer| layer.activation != Activation::Identity);
        let tangents = active.map(|layer| layer.outputs).sum();
        let products: usize = layers.iter().map(|layer| 2 * (1 + d) * layer.inputs * layer.outputs).sum();
        Self {
            operations: (2 + d) * term.columns().len()
                + products
                + (12 + d) * tangents
                + (3 + 2 * d) * term.outputs().len(),
            angles: term.columns().iter().filter(|column| column.kind != ColumnKind::Plain).count(),
            tangents,
        }
    }
}

/// A network that adds to functions; without layers if there is none.
fn write_network(text: &mut String, name: &str, term: Option<&NetworkTerm>) {
    let Some(term) = term else {
        push(text, format_args!("\nconst NetworkTerm model_{name}_network = {{0, NULL, 0, NULL, 0, NULL}};\n"));
        return;
    };
    let scaling = &term.network().scaling;
    let kind = |kind: ColumnKind| match kind {
        ColumnKind::Plain => "TERM_PLAIN",
        ColumnKind::Sine => "TERM_OF_SINE",
        ColumnKind::Cosine => "TERM_OF_COSINE",
    };
    let columns = term.columns().iter().zip(scaling.input_mean.iter().zip(&scaling.input_scale));
    let columns = columns.map(|(column, (mean, scale))| {
        format!("{}, {}, {}, {}", column.of, kind(column.kind), real(*mean), real(scale.recip()))
    });
    table(text, &format!("static const TermColumn {name}_network_columns"), columns, "0, TERM_PLAIN, 0.0, 0.0");
    let outputs = term.outputs().iter().zip(scaling.output_mean.iter().zip(&scaling.output_scale));
    let outputs = outputs.map(|(of, (mean, scale))| format!("{of}, {}, {}", real(*mean), real(*scale)));
    table(text, &format!("static const TermOutput {name}_network_outputs"), outputs, "0, 0.0, 0.0");
    let layers = &term.network().layers;
    for (index, layer) in layers.iter().enumerate() {
        let of_column = |column: usize| (0..layer.outputs).map(move |row| row * layer.inputs + column);
        let by_columns = (0..layer.inputs).flat_map(of_column).map(|place| layer.weight.get(place));
        let mut weights: Vec<f64> = by_columns.collect();
        // C has no empty arrays
        weights.resize(weights.len().max(1), 0.0);
        let bias: Vec<f64> = layer.bias.iter().collect();
        array(text, &format!("static const double {name}_network_weights_{index}"), &weights);
        array(text, &format!("static const double {name}_network_bias_{index}"), &bias);
    }
    let rows = layers.iter().enumerate().map(|(index, layer)| {
        let activation = match layer.activation {
            Activation::Tanh => "TERM_TANH",
            Activation::Sigmoid => "TERM_SIGMOID",
            Activation::Relu => "TERM_RELU",
            Activation::Gelu => "TERM_GELU",
            Activation::Silu => "TERM_SILU",
            Activation::Sine => "TERM_SINE",
            Activation::Identity => "TERM_IDENTITY",
        };
        let (inputs, outputs) = (layer.inputs, layer.outputs);
        format!("{inputs}, {outputs}, {name}_network_weights_{index}, {name}_network_bias_{index}, {activation}")
    });
    table(text, &format!("static const TermLayer {name}_network_layers"), rows, "");
    let [columns, layers, outputs] = [term.columns().len(), layers.len(), term.outputs().len()];
    push(
        text,
        format_args!(
            "\nconst NetworkTerm model_{name}_network = {{\n    {columns}, {name}_network_columns, {layers}, \
             {name}_network_layers, {outputs}, {name}_network_outputs\n}};\n"
        ),
    );
}

/// An array of structures; with one that is not used if there are none, as C has no empty arrays.
fn table(text: &mut String, declaration: &str, rows: impl Iterator<Item = String>, unused: &str) {
    let mut rows = rows.peekable();
    let unused = rows.peek().is_none().then(|| unused.to_owned());
    push(text, format_args!("\n{declaration}[] = {{\n"));
    for row in unused.into_iter().chain(rows) {
        push(text, format_args!("    {{{row}}},\n"));
    }
    text.push_str("};\n");
}

/// Multiplications, additions and divisions of a step of the fixed method; the formula is in `motion.c`.
fn operations(law: &Laid, n: usize, m: usize, sub_steps: f64) -> f64 {
    let of_column = |Column { factor, orders }: &Column| match factor {
        _ if *orders == 0 => 0,
        Factor::Angle => 8 * orders,
        Factor::Power { .. } => 3 * orders + 2,
    };
    let of_product = |Product { factors, coefficients }: &Product| {
        let of_coordinates = factors.iter().filter(|(column, _)| *column < n).count();
        let (f, c) = (factors.len(), coefficients.len());
        f + 2 * c + of_coordinates * (f.saturating_sub(1) + 2 * c)
    };
    let law: usize = law.columns.iter().map(of_column).chain(law.products.iter().map(of_product)).sum();
    let side = n * (1 + 2 * n + 5 * n * n + 2 * m);
    let solution = n * (n + 1) * (2 * n + 1) / 6 + n * (2 * n - 1);
    sub_steps * (4 * (law + side + solution) + 60 * n + 20 * m + 9) as f64 + 3.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::{Model, example};

    #[test]
    fn operations_are_those_of_a_count_by_hand() {
        let crane = example::crane();
        let Model::Motion(motion) = crane.model() else { panic!("the crane moves") };
        // rope angle: 8; the rope's length with powers 1 and 2: 8; products: 3 constants; cos and length, which
        // two functions have; the length's square: 1 + 2
        let law = 8 + 8 + 6 + (2 + 4 + 1 + 4) + (1 + 2);
        // 2 (1 + 4 + 20 + 2), 1 + 4, 1 + 2 + 3
        let stage = law + 54 + 5 + 6;
        // a step of 0.01 s has two of 0.005 s, of four stages, with 30 operations for each of four states and 20 for the input
        let expected = 2 * (4 * stage + 120 + 20 + 9) + 3;
        assert_eq!(operations(&Laid::out(motion.dynamics.law().dictionary()), 2, 1, 2.0), f64::from(expected));
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

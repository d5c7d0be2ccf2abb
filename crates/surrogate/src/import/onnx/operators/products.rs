//! Products of matrices.

use super::*;

/// Largest number of vectors that are multiplied with a matrix one by one.
const VECTORS: usize = 256;

impl GraphReader {
    pub(super) fn gemm(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let (alpha, beta) = (attributes.float("alpha", 1.0)?, attributes.float("beta", 1.0)?);
        let mut factor = |place: usize, name: &str| -> Made {
            let value = self.input(node, place)?;
            if value.shape().len() != 2 {
                return Err(ImportError::malformed(format!(
                    "a tensor of shape {:?}, expected two dimensions",
                    value.shape()
                )));
            }
            match attributes.integer(name).unwrap_or(0) {
                0 => Ok(value),
                _ => self.transposed(&value, &[1, 0]),
            }
        };
        let (a, b) = (factor(0, "transA")?, factor(1, "transB")?);
        let mut product = self.product(&a, &b)?;
        if alpha != 1.0 {
            product = self.mapped(&product, Elementwise::Linear, vec![alpha, 0.0])?;
        }
        let Some(c) = self.given(node, 2)?.cloned() else { return Ok(product) };
        let c = if beta == 1.0 { c } else { self.mapped(&c, Elementwise::Linear, vec![beta, 0.0])? };
        self.combined(Operation::Add, &product, &c)
    }

    pub(super) fn matmul(&mut self, node: &NodeProto) -> Made {
        let (a, b) = (self.input(node, 0)?, self.input(node, 1)?);
        self.product(&a, &b)
    }

    /// The matrix product; of tensors of more dimensions one for each of the others, vectors being rows or columns.
    pub(super) fn product(&mut self, a: &Value, b: &Value) -> Made {
        let (a_rank, b_rank) = (a.shape().len(), b.shape().len());
        if a_rank == 0 || b_rank == 0 {
            return Err(ImportError::malformed("a product with a single number, expected matrices"));
        }
        if a_rank == 1 {
            let row = self.reshaped(a, vec![1, a.shape()[0]])?;
            let product = self.product(&row, b)?;
            let mut shape = product.shape().to_vec();
            shape.remove(shape.len() - if b_rank == 1 { 1 } else { 2 });
            return self.reshaped(&product, shape);
        }
        if b_rank == 1 {
            let column = self.reshaped(b, vec![b.shape()[0], 1])?;
            let product = self.product(a, &column)?;
            let shape = product.shape()[..product.shape().len() - 1].to_vec();
            return self.reshaped(&product, shape);
        }
        let misfit = || ImportError::malformed(format!("a product of shapes {:?} and {:?}", a.shape(), b.shape()));
        let (rows, inner) = (a.shape()[a_rank - 2], a.shape()[a_rank - 1]);
        let columns = b.shape()[b_rank - 1];
        if b.shape()[b_rank - 2] != inner || inner == 0 {
            return Err(misfit());
        }
        let batch = broadcast(&a.shape()[..a_rank - 2], &b.shape()[..b_rank - 2]).map_err(|_| misfit())?;
        let shape = [batch.as_slice(), &[rows, columns]].concat();
        let count = within_limits(&shape)?;
        // for each element of the result where its sum begins in either factor
        let of_a = broadcast_places(&a.shape()[..a_rank - 2], &batch);
        let of_b = broadcast_places(&b.shape()[..b_rank - 2], &batch);
        let begins = |element: usize| {
            let (matrix, row, column) = (element / (rows * columns), element / columns % rows, element % columns);
            ((of_a[matrix] * rows + row) * inner, of_b[matrix] * inner * columns + column)
        };
        let (row, constant) = match (a, b) {
            (Value::Constant(a), Value::Constant(b)) => {
                let (x, y) = (a.data.doubles(), b.data.doubles());
                within_limits(&[count, inner])?;
                let products = (0..count)
                    .map(|element| {
                        let (first, second) = begins(element);
                        (0..inner).map(|k| x[first + k] * y[second + k * columns]).sum()
                    })
                    .collect();
                return Ok(Value::Constant(ConstantTensor::like(&a.data, shape, products)));
            }
            (Value::Row(row), Value::Constant(constant)) | (Value::Constant(constant), Value::Row(row)) => {
                (row, constant)
            }
            (Value::Row(_), Value::Row(_)) => {
                within_limits(&[count, inner])?;
                let factor = |reader: &mut Self, value: &Value, place: &dyn Fn(usize, usize) -> usize| {
                    let elements = (0..count).flat_map(|element| (0..inner).map(move |k| (element, k)));
                    let places: Vec<usize> = elements.map(|(element, k)| place(element, k)).collect();
                    reader.pick(value, &places, vec![count, inner])
                };
                let x = factor(self, a, &|element, k| begins(element).0 + k)?;
                let y = factor(self, b, &|element, k| begins(element).1 + k * columns)?;
                let products = self.combined(Operation::Multiply, &x, &y)?;
                let sums = self.folded(Operation::Add, &products, vec![count, 1])?;
                return self.reshaped(&sums, shape);
            }
        };
        let width = self.builder.width(row.value);
        let row_is_first = matches!(a, Value::Row(_));
        // a vector times a matrix, which is most of them, keeps its precision; weights of other vectors would be zero
        if row_is_first && count > 0 && count / columns <= VECTORS {
            weights_within_limits(count, inner)?;
            let mut products = Vec::new();
            for element in (0..count).step_by(columns) {
                let (first, second) = begins(element);
                let weight = of_data(
                    constant.data.picked(
                        &(0..columns)
                            .flat_map(|column| (0..inner).map(move |k| second + column + k * columns))
                            .collect::<Vec<_>>(),
                    ),
                );
                let bias = zeros_like(&weight, columns);
                let vector = self.picked(row, &(first..first + inner).collect::<Vec<_>>(), vec![inner])?;
                products.push(self.affine(&vector, weight, bias, vec![columns])?);
            }
            let products = match products.as_slice() {
                [product] => product.clone(),
                products => self.concatenated(products, 0)?,
            };
            return self.reshaped(&products, shape);
        }
        weights_within_limits(count, width)?;
        let numbers = constant.data.doubles();
        let mut weight = vec![0.0; count * width];
        for element in 0..count {
            let (first, second) = begins(element);
            for k in 0..inner {
                let (of_a, of_b) = (first + k, second + k * columns);
                let (variable, number) = if row_is_first { (of_a, numbers[of_b]) } else { (of_b, numbers[of_a]) };
                weight[element * width + variable] += number;
            }
        }
        self.affine(row, weight.into(), vec![0.0; count].into(), shape)
    }
}

/// Weights of a file, in its precision.
pub(super) fn of_data(data: Data) -> Numbers {
    match data {
        Data::Single(values) => values.into(),
        Data::Double(values) => values.into(),
        Data::Integer(values) => values.into_iter().map(|value| value as f64).collect::<Vec<f64>>().into(),
    }
}

fn zeros_like(numbers: &Numbers, count: usize) -> Numbers {
    match numbers {
        Numbers::Single(_) => vec![0.0f32; count].into(),
        Numbers::Double(_) => vec![0.0f64; count].into(),
    }
}

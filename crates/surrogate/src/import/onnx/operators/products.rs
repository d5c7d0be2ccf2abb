//! Products of matrices.

use super::*;

/// Largest number of vectors that are multiplied with a matrix one by one.
const VECTORS: usize = 256;

impl GraphReader {
    pub(super) fn gemm(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let (alpha, beta) = (attributes.float("alpha", 1.0)?, attributes.float("beta", 1.0)?);
        let a = self.matrix(node, 0, attributes.integer("transA").unwrap_or(0) != 0)?;
        let b = self.matrix(node, 1, attributes.integer("transB").unwrap_or(0) != 0)?;
        let mut product = self.product(&a, &b)?;
        if alpha != 1.0 {
            product = self.mapped(&product, Elementwise::Linear, vec![alpha, 0.0])?;
        }
        let Some(c) = self.given(node, 2)?.cloned() else { return Ok(product) };
        let c = if beta == 1.0 { c } else { self.mapped(&c, Elementwise::Linear, vec![beta, 0.0])? };
        self.combined(Operation::Add, &product, &c)
    }

    /// An input with two dimensions.
    fn matrix(&mut self, node: &NodeProto, place: usize, is_transposed: bool) -> Made {
        let value = self.input(node, place)?;
        if value.shape().len() != 2 {
            let message = format!("a tensor of shape {:?}, expected two dimensions", value.shape());
            return Err(ImportError::malformed(message));
        }
        if is_transposed { self.transposed(&value, &[1, 0]) } else { Ok(value) }
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
        let product = MatrixProduct::new(a.shape(), b.shape())?;
        match (a, b) {
            (Value::Constant(a), Value::Constant(b)) => product.of_constants(a, b),
            (Value::Row(_), Value::Row(_)) => self.product_of_rows(&product, a, b),
            // a vector times a matrix, which is most of them, keeps its precision; weights of other vectors would be zero
            (Value::Row(a), Value::Constant(b)) if product.count > 0 && product.count / product.columns <= VECTORS => {
                self.products_of_vectors(&product, a, b)
            }
            (Value::Row(row), Value::Constant(constant)) => self.product_as_weights(&product, row, constant, true),
            (Value::Constant(constant), Value::Row(row)) => self.product_as_weights(&product, row, constant, false),
        }
    }

    /// Sums of products of numbers that are not known.
    fn product_of_rows(&mut self, product: &MatrixProduct, a: &Value, b: &Value) -> Made {
        let MatrixProduct { inner, columns, count, .. } = *product;
        within_limits(&[count, inner])?;
        let (mut of_a, mut of_b) = (Vec::with_capacity(count * inner), Vec::with_capacity(count * inner));
        for element in 0..count {
            let [first, second] = product.begins(element);
            of_a.extend((0..inner).map(|k| first + k));
            of_b.extend((0..inner).map(|k| second + k * columns));
        }
        let x = self.pick(a, &of_a, vec![count, inner])?;
        let y = self.pick(b, &of_b, vec![count, inner])?;
        let products = self.combined(Operation::Multiply, &x, &y)?;
        let sums = self.folded(Operation::Add, &products, vec![count, 1])?;
        self.reshaped(&sums, product.shape.clone())
    }

    /// One layer for each row of the first factor.
    fn products_of_vectors(&mut self, product: &MatrixProduct, row: &RowTensor, constant: &ConstantTensor) -> Made {
        let MatrixProduct { inner, columns, count, .. } = *product;
        weights_within_limits(count, inner)?;
        let mut products = Vec::new();
        for element in (0..count).step_by(columns) {
            let [first, second] = product.begins(element);
            let places: Vec<usize> =
                (0..columns).flat_map(|column| (0..inner).map(move |k| second + column + k * columns)).collect();
            let weight = of_data(constant.data.picked(&places));
            let bias = zeros_like(&weight, columns);
            let vector = self.picked(row, &(first..first + inner).collect::<Vec<_>>(), vec![inner])?;
            products.push(self.affine(&vector, weight, bias, vec![columns])?);
        }
        let products = match products.as_slice() {
            [product] => product.clone(),
            products => self.concatenated(products, 0)?,
        };
        self.reshaped(&products, product.shape.clone())
    }

    /// One layer of all the numbers of a factor, which is the first one or the second one.
    fn product_as_weights(
        &mut self,
        product: &MatrixProduct,
        row: &RowTensor,
        constant: &ConstantTensor,
        row_is_first: bool,
    ) -> Made {
        let MatrixProduct { inner, columns, count, .. } = *product;
        let width = self.builder.width(row.value);
        weights_within_limits(count, width)?;
        let numbers = constant.data.doubles();
        let mut weight = vec![0.0; count * width];
        for element in 0..count {
            let [first, second] = product.begins(element);
            for k in 0..inner {
                let (of_a, of_b) = (first + k, second + k * columns);
                let (variable, number) = if row_is_first { (of_a, numbers[of_b]) } else { (of_b, numbers[of_a]) };
                weight[element * width + variable] += number;
            }
        }
        self.affine(row, weight.into(), vec![0.0; count].into(), product.shape.clone())
    }
}

/// Where the factors of a product of matrices have their numbers.
struct MatrixProduct {
    rows: usize,
    /// Number of products in each sum.
    inner: usize,
    columns: usize,
    shape: Vec<usize>,
    /// Number of elements of the result.
    count: usize,
    /// The matrix of either factor that each matrix of the result is of.
    of_a: Vec<usize>,
    of_b: Vec<usize>,
}

impl MatrixProduct {
    /// The product of tensors with these shapes, of at least two dimensions.
    fn new(a: &[usize], b: &[usize]) -> Result<Self, ImportError> {
        let ([of_a @ .., rows, inner], [of_b @ .., other_inner, columns]) = (a, b) else {
            return Err(misfit(a, b));
        };
        if other_inner != inner || *inner == 0 {
            return Err(misfit(a, b));
        }
        let batch = broadcast(of_a, of_b).map_err(|_| misfit(a, b))?;
        let shape = [batch.as_slice(), &[*rows, *columns]].concat();
        let count = within_limits(&shape)?;
        let (of_a, of_b) = (broadcast_places(of_a, &batch), broadcast_places(of_b, &batch));
        Ok(Self { rows: *rows, inner: *inner, columns: *columns, shape, count, of_a, of_b })
    }

    /// Where the sum of an element of the result begins in either factor.
    #[inline]
    fn begins(&self, element: usize) -> [usize; 2] {
        let Self { rows, inner, columns, .. } = *self;
        let (matrix, row, column) = (element / (rows * columns), element / columns % rows, element % columns);
        [(self.of_a[matrix] * rows + row) * inner, self.of_b[matrix] * inner * columns + column]
    }

    fn of_constants(&self, a: &ConstantTensor, b: &ConstantTensor) -> Made {
        let (x, y) = (a.data.doubles(), b.data.doubles());
        within_limits(&[self.count, self.inner])?;
        let sums = (0..self.count)
            .map(|element| {
                let [first, second] = self.begins(element);
                (0..self.inner).map(|k| x[first + k] * y[second + k * self.columns]).sum()
            })
            .collect();
        Ok(Value::Constant(ConstantTensor::like(&a.data, self.shape.clone(), sums)))
    }
}

fn misfit(a: &[usize], b: &[usize]) -> ImportError {
    ImportError::malformed(format!("a product of shapes {a:?} and {b:?}"))
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

//! Operators that only move elements: other shapes, parts, several tensors as one.

use super::*;

impl GraphReader {
    pub(super) fn flatten(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let shape = value.shape();
        let at = Attributes::of(node).integer("axis").unwrap_or(1);
        let at = match at {
            _ if at == shape.len() as i64 => shape.len(),
            _ => axis(at, shape.len())?,
        };
        let flat = vec![shape[..at].iter().product(), shape[at..].iter().product()];
        self.reshaped(&value, flat)
    }

    pub(super) fn reshape(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let wanted = self.required_constant(node, 1)?;
        let keeps_zero = Attributes::of(node).integer("allowzero").unwrap_or(0) != 0;
        let mut shape = Vec::new();
        let mut rest = None;
        for (place, dim) in wanted.integers()?.iter().enumerate() {
            shape.push(match *dim {
                -1 if rest.is_none() => {
                    rest = Some(place);
                    1
                }
                0 if !keeps_zero => {
                    let same = value.shape().get(place).copied();
                    same.ok_or_else(|| ImportError::malformed("a dimension of 0 that the input does not have"))?
                }
                dim => length(dim)?,
            });
        }
        let known = within_limits(&shape)?;
        if let Some(place) = rest {
            let count: usize = value.shape().iter().product();
            if known == 0 || !count.is_multiple_of(known) {
                return Err(ImportError::malformed(format!(
                    "a shape of {:?} is to become {:?}",
                    value.shape(),
                    wanted.integers()?
                )));
            }
            shape[place] = count / known;
        }
        // of a file for a batch of another size: all that follows from the inputs has one row
        self.reshaped(&value, shape)
    }

    pub(super) fn squeeze(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let shape = value.shape();
        let squeezed: Vec<usize> = match self.integers(node, 1, "axes")? {
            Some(axes) => axes.iter().map(|at| axis(*at, shape.len())).collect::<Result<_, _>>()?,
            None => (0..shape.len()).filter(|at| shape[*at] == 1).collect(),
        };
        let rest = (0..shape.len()).filter(|at| !squeezed.contains(at)).map(|at| shape[at]).collect();
        self.reshaped(&value, rest)
    }

    pub(super) fn unsqueeze(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let axes = self.required_integers(node, 1, "axes")?;
        let rank = value.shape().len() + axes.len();
        let added: Vec<usize> = axes.iter().map(|at| axis(*at, rank)).collect::<Result<_, _>>()?;
        let mut old = value.shape().iter();
        let shape: Option<Vec<usize>> =
            (0..rank).map(|at| if added.contains(&at) { Some(1) } else { old.next().copied() }).collect();
        self.reshaped(&value, shape.ok_or_else(|| ImportError::malformed("an axis is given twice"))?)
    }

    pub(super) fn transpose(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let rank = value.shape().len();
        let order: Vec<usize> = match Attributes::of(node).integers("perm") {
            Some(order) => order.iter().map(|at| axis(*at, rank)).collect::<Result<_, _>>()?,
            None => (0..rank).rev().collect(),
        };
        let mut sorted = order.clone();
        sorted.sort_unstable();
        if sorted != (0..rank).collect::<Vec<_>>() {
            return Err(ImportError::malformed(format!("perm {order:?} of {rank} dimensions")));
        }
        self.transposed(&value, &order)
    }

    pub(super) fn expand(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let wanted = lengths(self.required_constant(node, 1)?.integers()?)?;
        let shape = broadcast(value.shape(), &wanted)?;
        self.expanded(&value, &shape)
    }

    pub(super) fn tile(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let times = lengths(self.required_constant(node, 1)?.integers()?)?;
        let from = value.shape().to_vec();
        if times.len() != from.len() {
            return Err(ImportError::malformed(format!("{} repeats of {} dimensions", times.len(), from.len())));
        }
        let shape: Option<Vec<usize>> = from.iter().zip(&times).map(|(dim, times)| dim.checked_mul(*times)).collect();
        let shape = shape.ok_or_else(|| ImportError::too_large("a tensor that is too large"))?;
        within_limits(&shape)?;
        let strides = strides(&from);
        let found = places(&shape, |index| {
            index.iter().zip(&from).zip(&strides).map(|((index, dim), stride)| index % dim * stride).sum()
        });
        self.pick(&value, &found, shape)
    }

    pub(super) fn concat(&mut self, node: &NodeProto) -> Made {
        let values = (0..node.input.len()).map(|place| self.input(node, place)).collect::<Result<Vec<_>, _>>()?;
        let at = Attributes::of(node).integer("axis").ok_or_else(|| missing_attribute("axis"))?;
        self.concatenated(&values, at)
    }

    pub(super) fn concatenated(&mut self, values: &[Value], at: i64) -> Made {
        let first = values.first().ok_or_else(|| ImportError::malformed("nothing to put together"))?;
        let first = first.shape().to_vec();
        let at = axis(at, first.len())?;
        let mut shape = first.clone();
        shape[at] = 0;
        for value in values {
            let fits = value.shape().len() == first.len()
                && (0..first.len()).all(|place| place == at || value.shape()[place] == first[place]);
            if !fits {
                return Err(ImportError::malformed(format!(
                    "shapes {first:?} and {:?} put together along axis {at}",
                    value.shape()
                )));
            }
            shape[at] += value.shape()[at];
        }
        within_limits(&shape)?;
        // where each element is from
        let mut of: Vec<(usize, usize)> = Vec::new();
        for (number, value) in values.iter().enumerate() {
            of.extend((0..value.shape()[at]).map(|within| (number, within)));
        }
        let strides: Vec<Vec<usize>> = values.iter().map(|value| strides(value.shape())).collect();
        let mut found = places(&shape, |index| {
            let (number, within) = of[index[at]];
            let dims = index.iter().zip(&strides[number]).enumerate();
            let place: usize =
                dims.map(|(place, (index, stride))| stride * if place == at { within } else { *index }).sum();
            [number as u32, place as u32]
        });
        let constants: Option<Vec<&ConstantTensor>> = values.iter().map(Value::constant).collect();
        if let Some(tensors) = constants {
            let all: Vec<Vec<f64>> = tensors.iter().map(|tensor| tensor.data.doubles()).collect();
            let values = found.iter().map(|[number, place]| all[*number as usize][*place as usize]).collect();
            return Ok(Value::Constant(ConstantTensor::like(&tensors[0].data, shape, values)));
        }
        let mut rows = Vec::new();
        for value in values {
            rows.push(match value {
                Value::Row(row) => row.clone(),
                Value::Constant(tensor) => constant_row(&mut self.builder, tensor)?,
            });
        }
        found.iter_mut().for_each(|[number, _]| *number = rows[*number as usize].value as u32);
        let is_single = rows.iter().all(|row| row.is_single);
        Ok(Value::Row(RowTensor { shape, value: self.builder.columns(found)?, is_single }))
    }

    pub(super) fn slice(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let shape = value.shape().to_vec();
        let starts = self.required_integers(node, 1, "starts")?;
        let ends = self.required_integers(node, 2, "ends")?;
        let axes = self.integers(node, 3, "axes")?.unwrap_or_else(|| (0..starts.len() as i64).collect());
        let steps = self.integers(node, 4, "steps")?.unwrap_or_else(|| vec![1; starts.len()]);
        if [ends.len(), axes.len(), steps.len()] != [starts.len(); 3] {
            return Err(ImportError::malformed("starts, ends, axes and steps of different lengths"));
        }
        let mut chosen: Vec<Vec<usize>> = shape.iter().map(|dim| (0..*dim).collect()).collect();
        for (((start, end), at), step) in starts.iter().zip(&ends).zip(&axes).zip(&steps) {
            let at = axis(*at, shape.len())?;
            chosen[at] = Slice { start: *start, end: *end, step: *step }.positions(shape[at] as i64)?;
        }
        self.chosen(&value, &chosen)
    }

    /// Some elements along each axis.
    pub(super) fn chosen(&mut self, value: &Value, chosen: &[Vec<usize>]) -> Made {
        let strides = strides(value.shape());
        let shape: Vec<usize> = chosen.iter().map(Vec::len).collect();
        if shape.contains(&0) && matches!(value, Value::Row(_)) {
            return Err(ImportError::unsupported("nothing is left"));
        }
        let found = places(&shape, |index| {
            index.iter().zip(chosen).zip(&strides).map(|((index, chosen), stride)| chosen[*index] * stride).sum()
        });
        self.pick(value, &found, shape)
    }

    pub(super) fn gather(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let indices = self.required_constant(node, 1)?;
        let at = axis(Attributes::of(node).integer("axis").unwrap_or(0), value.shape().len())?;
        let dim = value.shape()[at];
        let found = indices.integers()?.iter().map(|index| element(*index, dim)).collect::<Result<Vec<_>, _>>()?;
        let mut chosen: Vec<Vec<usize>> = value.shape().iter().map(|dim| (0..*dim).collect()).collect();
        chosen[at] = found;
        let picked = self.chosen(&value, &chosen)?;
        let shape = [&value.shape()[..at], &indices.shape, &value.shape()[at + 1..]].concat();
        self.reshaped(&picked, shape)
    }

    pub(super) fn split(&mut self, node: &NodeProto) -> Result<Vec<Value>, ImportError> {
        let value = self.input(node, 0)?;
        let attributes = Attributes::of(node);
        let at = axis(attributes.integer("axis").unwrap_or(0), value.shape().len())?;
        let dim = value.shape()[at];
        let sizes = match self.integers(node, 1, "split")? {
            Some(sizes) => lengths(&sizes)?,
            None => {
                let count = node.output.len();
                let each = dim.div_ceil(count.max(1));
                (0..count).map(|part| each.min(dim.saturating_sub(part * each))).collect()
            }
        };
        if sizes.iter().try_fold(0usize, |sum, size| sum.checked_add(*size)) != Some(dim) {
            return Err(ImportError::malformed(format!("{dim} elements in parts of {sizes:?}")));
        }
        let mut first = 0;
        let mut parts = Vec::new();
        for size in sizes {
            let mut chosen: Vec<Vec<usize>> = value.shape().iter().map(|dim| (0..*dim).collect()).collect();
            chosen[at] = (first..first + size).collect();
            parts.push(self.chosen(&value, &chosen)?);
            first += size;
        }
        Ok(parts)
    }

    pub(super) fn extract(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let indices = self.required_constant(node, 1)?;
        let (rank, dim) = (value.shape().len(), value.shape().last().copied().unwrap_or(1));
        if rank == 0 {
            return Err(ImportError::malformed("a tensor without dimensions"));
        }
        let mut chosen: Vec<Vec<usize>> = value.shape().iter().map(|dim| (0..*dim).collect()).collect();
        chosen[rank - 1] = indices.integers()?.iter().map(|index| element(*index, dim)).collect::<Result<_, _>>()?;
        self.chosen(&value, &chosen)
    }
}

/// A slice along an axis, as the operator `Slice` has it: negative positions count from the end.
struct Slice {
    start: i64,
    end: i64,
    step: i64,
}

impl Slice {
    /// The positions that it takes of `length`.
    fn positions(&self, length: i64) -> Result<Vec<usize>, ImportError> {
        let Self { start, end, step } = *self;
        let (first, limit) = match step {
            0 => return Err(ImportError::malformed("a step of 0")),
            1.. => (from_start(start, length).clamp(0, length), from_start(end, length).clamp(0, length)),
            _ if end == i64::MIN => (from_start(start, length).clamp(-1, length - 1), -1),
            _ => (from_start(start, length).clamp(-1, length - 1), from_start(end, length).clamp(-1, length - 1)),
        };
        let mut positions = Vec::new();
        let mut position = first;
        while (step > 0 && position < limit) || (step < 0 && position > limit) {
            positions.push(position as usize);
            position = match position.checked_add(step) {
                Some(next) => next,
                None => break,
            };
        }
        Ok(positions)
    }
}

/// A position counted from the start.
fn from_start(position: i64, length: i64) -> i64 {
    if position < 0 { position.saturating_add(length) } else { position }
}

//! Operators that move a window over a tensor: convolutions and pooling, with their padding.

use super::{products::of_data, *};

/// Largest number of places of a window that are computed one by one.
const PARTS: usize = 4096;

/// A window that moves over the dimensions behind the batch and the channels.
struct Window {
    /// Its positions along each dimension.
    positions: Vec<usize>,
    /// Elements under the window for each position, none where it reaches over the edge.
    elements: Vec<Vec<Option<usize>>>,
}

impl Window {
    fn new(node: &NodeProto, shape: &[usize], kernel: &[usize]) -> Result<Self, ImportError> {
        let attributes = Attributes::of(node);
        let rank = shape.len();
        if kernel.len() != rank || rank == 0 || kernel.contains(&0) || shape.contains(&0) {
            return Err(ImportError::malformed(format!("a kernel of shape {kernel:?} for dimensions {shape:?}")));
        }
        if attributes.integer("ceil_mode").unwrap_or(0) != 0 {
            return Err(ImportError::unsupported("attribute `ceil_mode` is not 0"));
        }
        let steps = strides(shape);
        let (strides, dilations) = (
            given(attributes, "strides", vec![1; rank], shape)?,
            given(attributes, "dilations", vec![1; rank], shape)?,
        );
        let mut pads = given(attributes, "pads", vec![0; 2 * rank], shape)?;
        let reach: Vec<usize> =
            (0..rank).map(|at| (kernel[at] - 1).saturating_mul(dilations[at]).saturating_add(1)).collect();
        let same = match attributes.text("auto_pad").as_deref() {
            None | Some("NOTSET" | "") => None,
            Some("VALID") => {
                pads = vec![0; 2 * rank];
                None
            }
            Some("SAME_UPPER") => Some(0),
            Some("SAME_LOWER") => Some(1),
            Some(other) => return Err(ImportError::malformed(format!("attribute `auto_pad` is {other:?}"))),
        };
        if let Some(odd) = same {
            for at in 0..rank {
                let all = ((shape[at].div_ceil(strides[at]) - 1) * strides[at] + reach[at]).saturating_sub(shape[at]);
                pads[at] = (all + odd) / 2;
                pads[rank + at] = all - pads[at];
            }
        }
        let positions: Option<Vec<usize>> = (0..rank)
            .map(|at| Some((shape[at] + pads[at] + pads[rank + at]).checked_sub(reach[at])? / strides[at] + 1))
            .collect();
        let positions = positions.ok_or_else(|| {
            let message = format!("a window of {reach:?} elements for dimensions {shape:?}");
            ImportError::malformed(message)
        })?;
        within_limits(&[within_limits(&positions)?, within_limits(kernel)?])?;
        let elements = places(&positions, |from| {
            places(kernel, |within| {
                (0..rank)
                    .map(|at| {
                        let place = (from[at] * strides[at] + within[at] * dilations[at]).checked_sub(pads[at])?;
                        (place < shape[at]).then_some(place * steps[at])
                    })
                    .sum::<Option<usize>>()
            })
        });
        if elements.iter().any(|elements| elements.iter().all(Option::is_none)) {
            return Err(ImportError::unsupported("a window that has nothing of the tensor"));
        }
        Ok(Self { positions, elements })
    }
}

/// Lengths of an attribute of a window over dimensions; by default the smallest that are allowed.
fn given(attributes: Attributes, name: &str, least: Vec<usize>, shape: &[usize]) -> Result<Vec<usize>, ImportError> {
    let Some(lengths) = attributes.integers(name).map(lengths).transpose()? else { return Ok(least) };
    let fits = lengths.len() == least.len()
        && lengths.iter().zip(&least).all(|(length, least)| (*least..MAX_ELEMENTS).contains(length));
    if fits {
        return Ok(lengths);
    }
    Err(ImportError::malformed(format!("attribute `{name}` is {lengths:?} for dimensions {shape:?}")))
}

impl GraphReader {
    pub(super) fn convolution(&mut self, node: &NodeProto) -> Made {
        let value = self.maps(node)?;
        let weight = self.required_constant(node, 1)?;
        let groups = Attributes::of(node).integer("group").unwrap_or(1);
        let ([_, channels, shape @ ..], [made, each, kernel @ ..]) = (value.shape(), weight.shape.as_slice()) else {
            return Err(ImportError::malformed(format!("shapes {:?} and {:?}", value.shape(), weight.shape)));
        };
        let groups = usize::try_from(groups).ok().filter(|groups| {
            *groups > 0 && each.checked_mul(*groups) == Some(*channels) && made.is_multiple_of(*groups) && *made > 0
        });
        let groups = groups.ok_or_else(|| {
            let (of_value, of_weight) = (value.shape(), &weight.shape);
            let message = format!("shapes {of_value:?} and {of_weight:?} that do not fit each other in these groups");
            ImportError::malformed(message)
        })?;
        if let Some(given) =
            Attributes::of(node).integers("kernel_shape").filter(|given| lengths(given).as_deref() != Ok(kernel))
        {
            return Err(ImportError::malformed(format!(
                "attribute `kernel_shape` is {given:?}, but the weight has {kernel:?}"
            )));
        }
        let bias = match self.constant(node, 2)? {
            Some(bias) if bias.data.len() != *made => {
                return Err(ImportError::malformed(format!("a bias of {} numbers, expected {made}", bias.data.len())));
            }
            Some(bias) => of_data(bias.data),
            None => of_data(ConstantTensor::like(&weight.data, vec![*made], vec![0.0; *made]).data),
        };
        let window = Window::new(node, shape, kernel)?;
        let (numbers, size) = (weight.data.doubles(), kernel.iter().product::<usize>());
        self.moved(&value, &window, &bias, groups, |output, channel, _, element| {
            numbers[(output * each + channel) * size + element]
        })
    }

    pub(super) fn average_pool(&mut self, node: &NodeProto) -> Made {
        let (value, window) = self.pooled(node)?;
        let channels = value.shape()[1];
        let counts_all = Attributes::of(node).integer("count_include_pad").unwrap_or(0) != 0;
        let shares: Vec<f64> = window
            .elements
            .iter()
            .map(|elements| match counts_all {
                true => 1.0 / elements.len() as f64,
                false => 1.0 / elements.iter().flatten().count() as f64,
            })
            .collect();
        let share = |_: usize, _: usize, position: usize, _: usize| shares[position];
        self.moved(&value, &window, &vec![0.0f64; channels].into(), channels, share)
    }

    pub(super) fn max_pool(&mut self, node: &NodeProto) -> Made {
        let (value, window) = self.pooled(node)?;
        let elements: Vec<Vec<usize>> = window
            .elements
            .iter()
            .map(|elements| {
                // an element that is there twice changes nothing
                let first = elements.iter().find_map(|element| *element).unwrap_or(0);
                elements.iter().map(|element| element.unwrap_or(first)).collect()
            })
            .collect();
        let size: usize = value.shape()[2..].iter().product();
        let maps = value.shape()[0] * value.shape()[1];
        let each = elements[0].len();
        let shape = [value.shape()[..2].to_vec(), window.positions].concat();
        let count = within_limits(&shape)?;
        within_limits(&[count, each])?;
        let found: Vec<usize> =
            (0..maps).flat_map(|map| elements.iter().flatten().map(move |element| map * size + element)).collect();
        let all = self.pick(&value, &found, vec![count, each])?;
        let largest = self.folded(Operation::Maximum, &all, vec![count, 1])?;
        self.reshaped(&largest, shape)
    }

    /// A tensor with a batch, channels, and other dimensions.
    fn maps(&self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        if value.shape().len() < 3 || value.shape().contains(&0) {
            return Err(ImportError::malformed(format!(
                "a shape of {:?}, expected the batch, channels, and other dimensions",
                value.shape()
            )));
        }
        Ok(value)
    }

    /// Pooled value, and the window.
    fn pooled(&self, node: &NodeProto) -> Result<(Value, Window), ImportError> {
        let value = self.maps(node)?;
        let kernel = Attributes::of(node).integers("kernel_shape").ok_or_else(|| missing_attribute("kernel_shape"))?;
        let window = Window::new(node, &value.shape()[2..], &lengths(kernel)?)?;
        Ok((value, window))
    }

    /// The mean or the largest of each channel.
    pub(super) fn global_pool(&mut self, node: &NodeProto) -> Made {
        let value = self.maps(node)?;
        let kept: Vec<usize> =
            value.shape().iter().enumerate().map(|(at, dim)| if at < 2 { *dim } else { 1 }).collect();
        match node.op_type.as_str() {
            "GlobalMaxPool" => self.folded(Operation::Maximum, &value, kept),
            _ => {
                let size: usize = value.shape()[2..].iter().product();
                self.sum(&value, kept, 1.0 / size as f64)
            }
        }
    }

    /// Weighted sums of the elements in a window: by output, channel of its group, position, and element of the window.
    fn moved(
        &mut self,
        value: &Value,
        window: &Window,
        bias: &Numbers,
        groups: usize,
        weight: impl Fn(usize, usize, usize, usize) -> f64,
    ) -> Made {
        let (rows, channels) = (value.shape()[0], value.shape()[1]);
        let size: usize = value.shape()[2..].iter().product();
        let (outputs, each, count) = (bias.len() / groups, channels / groups, window.elements.len());
        let shape = [vec![rows, bias.len()], window.positions.clone()].concat();
        weights_within_limits(within_limits(&shape)?, each * window.elements[0].len())?;
        let parts = within_limits(&[rows, groups, count])?;
        if parts > PARTS {
            return Err(ImportError::too_large(format!(
                "a window of {parts} places, groups and rows in all, expected at most {PARTS}"
            )));
        }
        let mut products = Vec::new();
        for part in 0..parts {
            let (from, group, position) = (part / (groups * count), part / count % groups, part % count);
            let elements = window.elements[position].iter().enumerate();
            let elements: Vec<(usize, usize)> = elements.filter_map(|(at, element)| Some((at, (*element)?))).collect();
            let mut places = Vec::new();
            for channel in 0..each {
                let begin = ((from * channels) + group * each + channel) * size;
                places.extend(elements.iter().map(|(_, element)| begin + element));
            }
            let first = group * outputs;
            let weights = (first..first + outputs)
                .flat_map(|output| (0..each).map(move |channel| (output, channel)))
                .flat_map(|(output, channel)| elements.iter().map(move |(at, _)| (output, channel, *at)))
                .map(|(output, channel, at)| weight(output, channel, position, at));
            let (weights, bias) = match bias {
                Numbers::Single(bias) => (
                    weights.map(|weight| weight as f32).collect::<Vec<_>>().into(),
                    bias[first..first + outputs].to_vec().into(),
                ),
                Numbers::Double(bias) => {
                    (weights.collect::<Vec<_>>().into(), bias[first..first + outputs].to_vec().into())
                }
            };
            products.push(match self.pick(value, &places, vec![places.len()])? {
                Value::Row(taken) => self.affine(&taken, weights, bias, vec![outputs])?,
                Value::Constant(_) => {
                    return Err(ImportError::unsupported("a constant, expected what follows from the inputs"));
                }
            });
        }
        let products = self.concatenated(&products, 0)?;
        let split = [rows, groups, count, outputs];
        let products = self.reshaped(&products, split.to_vec())?;
        let moved = self.transposed(&products, &[0, 1, 3, 2])?;
        self.reshaped(&moved, shape)
    }

    pub(super) fn pad(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let shape = value.shape().to_vec();
        let attributes = Attributes::of(node);
        let pads = self.required_integers(node, 1, "pads")?;
        let axes = self.integers(node, 3, "axes")?.unwrap_or_else(|| (0..shape.len() as i64).collect());
        if pads.len() != 2 * axes.len() {
            return Err(ImportError::malformed(format!("{} pads for {} axes", pads.len(), axes.len())));
        }
        let mut around = vec![(0i64, 0i64); shape.len()];
        for (number, at) in axes.iter().enumerate() {
            around[axis(*at, shape.len())?] = (pads[number], pads[axes.len() + number]);
        }
        let padded: Option<Vec<usize>> = shape
            .iter()
            .zip(&around)
            .map(|(dim, (before, behind))| {
                let length = (*dim as i64).checked_add(*before)?.checked_add(*behind)?;
                usize::try_from(length).ok()
            })
            .collect();
        let misfit = || ImportError::malformed(format!("pads of {around:?} for a shape of {shape:?}"));
        let padded = padded.ok_or_else(misfit)?;
        within_limits(&padded)?;
        let mode = attributes.text("mode").unwrap_or_else(|| "constant".into());
        let strides = strides(&shape);
        // behind the last element comes the constant
        let count: usize = shape.iter().product();
        let found = places(&padded, |index| {
            (0..shape.len())
                .map(|at| {
                    let place = (index[at] as i64).saturating_sub(around[at].0);
                    Some(inside(&mode, place, shape[at])? * strides[at])
                })
                .sum::<Option<usize>>()
                .unwrap_or(count)
        });
        match mode.as_str() {
            "constant" => {
                let constant = match self.constant(node, 2)? {
                    Some(tensor) => tensor.data.doubles().first().copied().unwrap_or(0.0),
                    None => attributes.float("value", 0.0)?,
                };
                let like = value.constant().map_or(Data::Double(Vec::new()), |tensor| tensor.data.picked(&[]));
                let constant = Value::Constant(ConstantTensor::like(&like, vec![1], vec![constant]));
                let flat = self.reshaped(&value, vec![count])?;
                let all = self.concatenated(&[flat, constant], 0)?;
                self.pick(&all, &found, padded)
            }
            "edge" | "reflect" if !found.contains(&count) => self.pick(&value, &found, padded),
            "edge" | "reflect" => Err(misfit()),
            other => {
                let message = format!("attribute `mode` is {other:?}, expected \"constant\", \"edge\" or \"reflect\"");
                Err(ImportError::unsupported(message))
            }
        }
    }
}

/// The element of a dimension that a place inside or outside of it has; none if that is the constant.
fn inside(mode: &str, place: i64, length: usize) -> Option<usize> {
    let last = length as i64 - 1;
    let place = match mode {
        "edge" => place.clamp(0, last.max(0)),
        "reflect" if place < 0 => -place,
        "reflect" if place > last => 2 * last - place,
        _ => place,
    };
    usize::try_from(place).ok().filter(|place| *place < length)
}

//! Reads TFLite files: a graph of tensors and operators. Sizes and shapes are checked here, so that running cannot fail.
//!
//! The numbers of fields and operators are those of TensorFlow's `schema.fbs`.

use std::collections::{BTreeMap, BTreeSet};

use half::f16;

use super::NetworkError;
use super::convolution::{Activation, Convolution, DepthwiseConvolution};
use super::flatbuffer::{Table, ints};
use super::operation::Operation;
use super::window::{ImageShape, Padding, Window};

/// Most values of one tensor.
const MOST_VALUES: usize = 1 << 24;
/// Most values of all weights together.
const MOST_WEIGHTS: usize = 1 << 25;
/// Most products of one run.
const MOST_PRODUCTS: usize = 20_000_000_000;

/// An operation with the tensors that it reads and writes.
#[derive(Debug)]
pub(super) struct GraphNode {
    pub(super) operation: Operation,
    pub(super) inputs: Vec<usize>,
    pub(super) output: usize,
}

/// What is to be computed, in order.
#[derive(Debug)]
pub(super) struct Graph {
    pub(super) nodes: Vec<GraphNode>,
    pub(super) input: usize,
    pub(super) input_shape: ImageShape,
    pub(super) outputs: Vec<usize>,
    /// Number of values of each tensor that is computed.
    pub(super) values: BTreeMap<usize, usize>,
}

/// An operator as the file has it.
struct Operator<'a> {
    code: i32,
    inputs: Vec<usize>,
    output: usize,
    options: Option<Table<'a>>,
}

struct Reader<'a> {
    tensors: Vec<Table<'a>>,
    buffers: Vec<Table<'a>>,
    /// For tensors that are another form of a constant: the constant.
    forms: BTreeMap<usize, usize>,
    /// Values of all weights read so far.
    weights: usize,
    products: usize,
}

/// Reads the part of a file that is needed for the outputs with these names.
pub(super) fn read(bytes: &[u8], outputs: &[&str]) -> Result<Graph, NetworkError> {
    if bytes.get(4..8) != Some(b"TFL3") {
        return Err(NetworkError::NotTflite);
    }
    let model = Table::root(bytes)?;
    let graph = model.tables(2)?.into_iter().next().ok_or(NetworkError::Damaged)?;
    let codes = codes(&model)?;
    let operators: Vec<Operator<'_>> =
        graph.tables(3)?.iter().map(|table| Operator::read(table, &codes)).collect::<Result<_, _>>()?;
    let mut reader = Reader {
        tensors: graph.tables(0)?,
        buffers: model.tables(4)?,
        forms: BTreeMap::new(),
        weights: 0,
        products: 0,
    };
    let outputs = outputs.iter().map(|name| reader.named(&graph, name)).collect::<Result<Vec<_>, _>>()?;
    let needed = needed(&operators, &outputs);
    let [input] = graph.ints(1)?[..] else {
        return Err(NetworkError::Unsupported { what: "more than one input".into() });
    };
    let input = usize::try_from(input).map_err(|_| NetworkError::Damaged)?;
    let input_shape = reader.image(input)?;
    let mut values = BTreeMap::from([(input, reader.values(input)?)]);
    let mut nodes = Vec::new();
    for (index, operator) in operators.iter().enumerate().filter(|(i, _)| needed.contains(i)) {
        let read = reader.node(operator, &values);
        if let Some(node) = read.map_err(|source| NetworkError::Operator { index, source: source.into() })? {
            values.insert(node.output, reader.values(node.output)?);
            nodes.push(node);
        }
    }
    if outputs.iter().any(|output| !values.contains_key(output)) {
        return Err(NetworkError::Damaged);
    }
    Ok(Graph { nodes, input, input_shape, outputs, values })
}

/// The kinds of operators that the file uses. Older files have them in a field of one byte.
fn codes(model: &Table<'_>) -> Result<Vec<i32>, NetworkError> {
    let code = |table: &Table<'_>| {
        Ok(table.int(3)?.unwrap_or(0).max(i32::from(table.byte(0)?.unwrap_or(0).cast_signed())))
    };
    model.tables(1)?.iter().map(code).collect()
}

/// Which operators the outputs depend on.
fn needed(operators: &[Operator<'_>], outputs: &[usize]) -> BTreeSet<usize> {
    let mut tensors: BTreeSet<usize> = outputs.iter().copied().collect();
    let mut needed = BTreeSet::new();
    for (index, operator) in operators.iter().enumerate().rev() {
        if tensors.contains(&operator.output) {
            tensors.extend(&operator.inputs);
            needed.insert(index);
        }
    }
    needed
}

impl<'a> Operator<'a> {
    fn read(table: &Table<'a>, codes: &[i32]) -> Result<Self, NetworkError> {
        let code = usize::try_from(table.int(0)?.unwrap_or(0)).ok().and_then(|code| codes.get(code));
        let places = |field| -> Result<Vec<usize>, NetworkError> {
            // A tensor that is left out has the number -1.
            Ok(table.ints(field)?.into_iter().filter_map(|tensor| usize::try_from(tensor).ok()).collect())
        };
        let output = places(2)?.first().copied().ok_or(NetworkError::Damaged)?;
        let code = *code.ok_or(NetworkError::Damaged)?;
        Ok(Self { code, inputs: places(1)?, output, options: table.table(4)? })
    }

    fn input(&self, i: usize) -> Result<usize, NetworkError> {
        self.inputs.get(i).copied().ok_or(NetworkError::Damaged)
    }

    fn byte(&self, field: usize) -> Result<u8, NetworkError> {
        Ok(self.options.map(|options| options.byte(field)).transpose()?.flatten().unwrap_or(0))
    }

    fn int(&self, field: usize, default: i32) -> Result<i32, NetworkError> {
        Ok(self.options.map(|options| options.int(field)).transpose()?.flatten().unwrap_or(default))
    }

    /// A size among the options.
    fn size(&self, field: usize, default: i32) -> Result<usize, NetworkError> {
        usize::try_from(self.int(field, default)?).map_err(|_| NetworkError::Damaged)
    }

    fn activation(&self, field: usize) -> Result<Activation, NetworkError> {
        match self.byte(field)? {
            0 => Ok(Activation::None),
            1 => Ok(Activation::Relu),
            3 => Ok(Activation::Relu6),
            other => Err(NetworkError::Unsupported { what: format!("the activation function {other}") }),
        }
    }

    /// A window of `size` on an image: padding, then strides in the fields 0 to 2.
    fn window(&self, input: ImageShape, size: [usize; 2]) -> Result<Window, NetworkError> {
        let padding = if self.byte(0)? == 0 { Padding::Same } else { Padding::Valid };
        Window::new(input, size, [self.size(2, 0)?, self.size(1, 0)?], padding)
    }

    fn undilated(&self, fields: [usize; 2]) -> Result<(), NetworkError> {
        match [self.int(fields[0], 1)?, self.int(fields[1], 1)?] {
            [1, 1] => Ok(()),
            _ => Err(NetworkError::Unsupported { what: "a dilated convolution".into() }),
        }
    }
}

impl Reader<'_> {
    fn tensor(&self, tensor: usize) -> Result<&Table<'_>, NetworkError> {
        self.tensors.get(tensor).ok_or(NetworkError::Damaged)
    }

    fn named(&self, graph: &Table<'_>, name: &str) -> Result<usize, NetworkError> {
        for output in graph.ints(2)? {
            let output = usize::try_from(output).map_err(|_| NetworkError::Damaged)?;
            if self.tensor(output)?.list(3, 1)? == name.as_bytes() {
                return Ok(output);
            }
        }
        Err(NetworkError::NoOutput { name: name.into() })
    }

    fn shape(&self, tensor: usize) -> Result<Vec<usize>, NetworkError> {
        let sizes = self.tensor(tensor)?.ints(0)?.into_iter().map(usize::try_from);
        let shape: Vec<usize> = sizes.collect::<Result<_, _>>().map_err(|_| NetworkError::Damaged)?;
        let product = shape.iter().try_fold(1, |product: usize, size| product.checked_mul(*size));
        match product {
            Some(0) => Err(NetworkError::Shape),
            Some(values) if values <= MOST_VALUES => Ok(shape),
            other => Err(NetworkError::TooLarge {
                what: "number of values of a tensor",
                is: other.unwrap_or(usize::MAX),
                most: MOST_VALUES,
            }),
        }
    }

    fn values(&self, tensor: usize) -> Result<usize, NetworkError> {
        Ok(self.shape(tensor)?.iter().product())
    }

    /// The shape of a tensor that is one image.
    fn image(&self, tensor: usize) -> Result<ImageShape, NetworkError> {
        match self.shape(tensor)?[..] {
            [1, height, width, channels] => Ok(ImageShape { height, width, channels }),
            _ => Err(NetworkError::Shape),
        }
    }

    /// The bytes of a constant; empty for tensors that are computed.
    fn bytes(&self, tensor: usize) -> Result<&[u8], NetworkError> {
        let buffer = usize::try_from(self.tensor(tensor)?.int(2)?.unwrap_or(0)).ok();
        let buffer = buffer.and_then(|buffer| self.buffers.get(buffer)).ok_or(NetworkError::Damaged)?;
        buffer.list(0, 1)
    }

    fn is_constant(&self, tensor: usize) -> Result<bool, NetworkError> {
        Ok(self.forms.contains_key(&tensor) || !self.bytes(tensor)?.is_empty())
    }

    /// The values of a constant.
    fn constant(&mut self, tensor: usize) -> Result<Vec<f32>, NetworkError> {
        let tensor = self.forms.get(&tensor).copied().unwrap_or(tensor);
        let (count, bytes) = (self.values(tensor)?, self.bytes(tensor)?);
        let values: Vec<f32> = match self.tensor(tensor)?.byte(1)?.unwrap_or(0) {
            0 => bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
            1 => bytes.as_chunks().0.iter().map(|b| f16::from_le_bytes(*b).to_f32()).collect(),
            other => return Err(NetworkError::Unsupported { what: format!("weights of type {other}") }),
        };
        let values = match self.tensor(tensor)?.table(6)? {
            Some(sparsity) => dense(&self.shape(tensor)?, &sparsity, &values)?,
            None => values,
        };
        if values.len() != count {
            return Err(NetworkError::Damaged);
        }
        self.weights += count;
        match self.weights <= MOST_WEIGHTS {
            true => Ok(values),
            false => Err(NetworkError::TooLarge {
                what: "number of weights",
                is: self.weights,
                most: MOST_WEIGHTS,
            }),
        }
    }

    /// The whole numbers of a constant.
    fn numbers(&self, tensor: usize) -> Result<Vec<usize>, NetworkError> {
        let numbers = ints(self.bytes(tensor)?).into_iter().map(usize::try_from);
        numbers.collect::<Result<_, _>>().map_err(|_| NetworkError::Damaged)
    }

    /// The operation of an operator; `None` where it only gives a constant another form.
    fn node(
        &mut self,
        operator: &Operator<'_>,
        computed: &BTreeMap<usize, usize>,
    ) -> Result<Option<GraphNode>, NetworkError> {
        let first = operator.input(0)?;
        // The others have weights, shapes and axes behind the first input.
        let inputs = match operator.code {
            0 => vec![first, operator.input(1)?],
            2 => operator.inputs.clone(),
            6 | 124 if self.is_constant(first)? => {
                let constant = self.forms.get(&first).copied().unwrap_or(first);
                self.forms.insert(operator.output, constant);
                return Ok(None);
            }
            _ => vec![first],
        };
        if inputs.iter().any(|input| !computed.contains_key(input)) {
            return Err(NetworkError::Unsupported {
                what: "a constant where a computed tensor is expected".into(),
            });
        }
        if computed.contains_key(&operator.output) {
            return Err(NetworkError::Damaged);
        }
        let operation = self.operation(operator, first)?;
        self.products += match &operation {
            Operation::Convolution(convolution) => convolution.products(),
            Operation::Depthwise(convolution) => convolution.products(),
            Operation::MaxPool(window) => window.products(),
            _ => self.values(operator.output)?,
        }
        .min(MOST_PRODUCTS);
        if self.products > MOST_PRODUCTS {
            let what = "number of products of one run";
            return Err(NetworkError::TooLarge { what, is: self.products, most: MOST_PRODUCTS });
        }
        Ok(Some(GraphNode { operation, inputs, output: operator.output }))
    }

    fn operation(&mut self, operator: &Operator<'_>, input: usize) -> Result<Operation, NetworkError> {
        let output = operator.output;
        let image_is = |reader: &Self, shape: ImageShape| fits(reader.image(output)? == shape);
        let (values, written) = (self.values(input)?, self.values(output)?);
        Ok(match operator.code {
            0 => {
                fits(self.shape(input)? == self.shape(operator.input(1)?)? && values == written)?;
                Operation::Add(operator.activation(0)?)
            }
            2 => self.concatenation(operator)?,
            3 => {
                operator.undilated([4, 5])?;
                let [_, rows, columns, _] = self.shape(operator.input(1)?)?[..] else {
                    return Err(NetworkError::Shape);
                };
                let window = operator.window(self.image(input)?, [rows, columns])?;
                let (weights, bias) = self.weighted(operator)?;
                let convolution = Convolution::new(window, &weights, &bias, operator.activation(3)?)?;
                image_is(self, convolution.shape())?;
                Operation::Convolution(convolution)
            }
            4 => {
                operator.undilated([5, 6])?;
                let [1, rows, columns, _] = self.shape(operator.input(1)?)?[..] else {
                    return Err(NetworkError::Shape);
                };
                let window = operator.window(self.image(input)?, [rows, columns])?;
                let (weights, bias) = self.weighted(operator)?;
                let convolution =
                    DepthwiseConvolution::new(window, &weights, &bias, operator.activation(4)?)?;
                image_is(self, convolution.shape())?;
                Operation::Depthwise(convolution)
            }
            5 => {
                let (shape, block) = (self.image(input)?, operator.size(0, 0)?);
                let pixels = block.checked_mul(block).filter(|n| *n > 0 && shape.channels.is_multiple_of(*n));
                let channels = shape.channels / pixels.ok_or(NetworkError::Shape)?;
                let (height, width) = (shape.height * block, shape.width * block);
                image_is(self, ImageShape { height, width, channels })?;
                Operation::DepthToSpace { input: shape, block }
            }
            9 => {
                let channels = values;
                let window = Window::new(
                    ImageShape { height: 1, width: 1, channels },
                    [1, 1],
                    [1, 1],
                    Padding::Valid,
                )?;
                let (weights, bias) = self.weighted(operator)?;
                let layer = Convolution::new(window, &weights, &bias, operator.activation(0)?)?;
                fits(layer.shape().channels == written)?;
                Operation::Convolution(layer)
            }
            14 => fits(values == written).map(|()| Operation::Logistic)?,
            17 => {
                let size = [operator.size(4, 0)?, operator.size(3, 0)?];
                let window = operator.window(self.image(input)?, size)?;
                let [height, width] = window.output;
                image_is(self, ImageShape { height, width, ..window.input })?;
                fits(operator.activation(5)? == Activation::None)?;
                Operation::MaxPool(window)
            }
            19 => fits(values == written).map(|()| Operation::Activation(Activation::Relu))?,
            21 => fits(values == written).map(|()| Operation::Activation(Activation::Relu6))?,
            22 => fits(values == written).map(|()| Operation::Copy)?,
            23 => {
                // Fields 2 and 3: whether corners are aligned, and whether the centres of pixels are at halves.
                if (operator.byte(2)?, operator.byte(3)?) != (0, 1) {
                    return Err(NetworkError::Unsupported { what: "a resizing by corners".into() });
                }
                let (shape, into) = (self.image(input)?, self.image(output)?);
                fits(shape.channels == into.channels)?;
                Operation::Resize { input: shape, output: into }
            }
            34 => {
                let (shape, into) = (self.image(input)?, self.image(output)?);
                let margins = self.numbers(operator.input(1)?)?;
                let [0, 0, top, bottom, left, right, front, back] = margins[..] else {
                    return Err(NetworkError::Shape);
                };
                let grown = |size: usize, a: usize, b: usize| size.saturating_add(a).saturating_add(b);
                fits(
                    grown(shape.height, top, bottom) == into.height
                        && grown(shape.width, left, right) == into.width
                        && grown(shape.channels, front, back) == into.channels,
                )?;
                Operation::Pad { input: shape, before: [top, left, front], output: into }
            }
            40 => {
                let shape = self.image(input)?;
                fits(self.numbers(operator.input(1)?)? == [1, 2] && written == shape.channels)?;
                Operation::Mean(shape)
            }
            54 => {
                let factors = self.constant(operator.input(1)?)?;
                fits(factors.len() == self.image(input)?.channels && values == written)?;
                Operation::Prelu(factors)
            }
            other => return Err(NetworkError::Unsupported { what: format!("the operator {other}") }),
        })
    }

    /// Weights, and a bias for each output: 0 where the file has none.
    fn weighted(&mut self, operator: &Operator<'_>) -> Result<(Vec<f32>, Vec<f32>), NetworkError> {
        let weights = operator.input(1)?;
        let outputs = match (operator.code, &self.shape(weights)?[..]) {
            (4, [.., channels]) => *channels,
            (_, [outputs, ..]) => *outputs,
            _ => return Err(NetworkError::Shape),
        };
        let bias = match operator.inputs.get(2) {
            Some(bias) => self.constant(*bias)?,
            None => vec![0.0; outputs],
        };
        fits(bias.len() == outputs)?;
        Ok((self.constant(weights)?, bias))
    }

    fn concatenation(&self, operator: &Operator<'_>) -> Result<Operation, NetworkError> {
        let whole = self.shape(operator.output)?;
        let axis = operator.size(0, 0)?;
        fits(axis < whole.len() && operator.activation(1)? == Activation::None)?;
        let mut along = 0;
        let mut pieces = Vec::new();
        for input in &operator.inputs {
            let shape = self.shape(*input)?;
            fits(shape.len() == whole.len())?;
            fits((0..whole.len()).all(|i| i == axis || shape[i] == whole[i]))?;
            along += shape[axis];
            pieces.push(shape[axis..].iter().product());
        }
        fits(along == whole[axis])?;
        Ok(Operation::Concatenate(pieces))
    }
}

/// The values of a sparse constant. Accepted are those whose last dimension leaves out zeros (compressed sparse rows).
fn dense(shape: &[usize], sparsity: &Table<'_>, values: &[f32]) -> Result<Vec<f32>, NetworkError> {
    let dimensions = sparsity.tables(2)?;
    let [whole @ .., last] = &dimensions[..] else { return Err(NetworkError::Damaged) };
    let mut in_order = sparsity.ints(0)?.into_iter().zip(0..);
    let is_plain = in_order.all(|(dimension, i)| dimension == i)
        && sparsity.list(1, 4)?.is_empty()
        && dimensions.len() == shape.len()
        && last.byte(0)? == Some(1)
        && whole.iter().all(|dimension| matches!(dimension.byte(0), Ok(None | Some(0))));
    if !is_plain {
        return Err(NetworkError::Unsupported { what: "sparse weights in blocks".into() });
    }
    let (starts, columns) = (indices(last, 2)?, indices(last, 4)?);
    let columns = columns.get(..values.len()).ok_or(NetworkError::Damaged)?;
    let width = *shape.last().ok_or(NetworkError::Shape)?;
    let mut dense = vec![0.0; shape.iter().product()];
    fits(starts.len() == dense.len() / width + 1)?;
    for (row, part) in dense.chunks_exact_mut(width).zip(starts.windows(2)) {
        let part = part[0]..part[1];
        let places = columns.get(part.clone()).zip(values.get(part)).ok_or(NetworkError::Damaged)?;
        for (column, value) in places.0.iter().zip(places.1) {
            *row.get_mut(*column).ok_or(NetworkError::Damaged)? = *value;
        }
    }
    Ok(dense)
}

/// A list of indices of 4, 2 or 1 byte; its kind is in the field, the list in the next.
fn indices(dimension: &Table<'_>, field: usize) -> Result<Vec<usize>, NetworkError> {
    let list = dimension.table(field + 1)?.ok_or(NetworkError::Damaged)?;
    match dimension.byte(field)? {
        Some(1) => {
            list.ints(0)?.into_iter().map(|i| usize::try_from(i).map_err(|_| NetworkError::Damaged)).collect()
        }
        Some(2) => Ok(list.list(0, 2)?.as_chunks().0.iter().map(|b| u16::from_le_bytes(*b).into()).collect()),
        Some(3) => Ok(list.list(0, 1)?.iter().map(|b| usize::from(*b)).collect()),
        _ => Err(NetworkError::Damaged),
    }
}

fn fits(it_does: bool) -> Result<(), NetworkError> {
    if it_does { Ok(()) } else { Err(NetworkError::Shape) }
}

//! Neural networks in TFLite files, on one core, in safe Rust.
//!
//! It knows the sixteen operators of the networks that ship with Armarium (`visionx/models/`), with weights in single or half
//! precision, and images of one size. It neither trains nor quantises. A file that is damaged, too large or asks for more is refused
//! when it is read; running cannot fail.
//!
//! The same input gives the same bits on every machine: vectors are as wide as the processor has them, but sums are in a fixed order, each
//! product and each sum is rounded by itself, and the exponential function is `libm`'s. Start at [`Network::read`].

mod convolution;
mod flatbuffer;
mod lanes;
mod operation;
mod tflite;
mod window;

use std::sync::Arc;

use operation::Operation;
pub(crate) use operation::sigmoid;

/// Why a network cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// It is no TFLite file.
    #[error("this is no TFLite file")]
    NotTflite,
    /// The file ends too early, or something in it points to nowhere.
    #[error("the file is damaged")]
    Damaged,
    /// The file needs something that is not built in.
    #[error("the file needs {what}, which is not supported")]
    Unsupported {
        /// What it needs.
        what: String,
    },
    /// The shapes of an operator's tensors do not fit it.
    #[error("the shapes of its tensors do not fit")]
    Shape,
    /// A size is above its limit.
    #[error("the {what} is {is}; at most {most} are accepted")]
    TooLarge {
        /// Of what.
        what: &'static str,
        /// The size.
        is: usize,
        /// The limit.
        most: usize,
    },
    /// An operator cannot be used.
    #[error("operator {index} of the file")]
    Operator {
        /// Its number in the file, from 0.
        index: usize,
        /// The reason.
        #[source]
        source: Box<NetworkError>,
    },
    /// The file has no output of this name.
    #[error("the file has no output `{name}`")]
    NoOutput {
        /// The name.
        name: String,
    },
}

/// A network with fixed sizes of its images.
#[derive(Clone, Debug)]
pub struct Network {
    plan: Arc<Plan>,
    /// Values of tensors; those that are not needed at the same time share one.
    slots: Vec<Vec<f32>>,
}

/// What a network computes, and where its values are.
#[derive(Debug)]
struct Plan {
    steps: Vec<PlannedOperation>,
    slots: Vec<usize>,
    input: Place,
    input_shape: [usize; 3],
    outputs: Vec<Place>,
}

#[derive(Debug)]
struct PlannedOperation {
    operation: Operation,
    inputs: Vec<Place>,
    output: Place,
}

/// The first `values` of a slot.
#[derive(Clone, Copy, Debug)]
struct Place {
    slot: usize,
    values: usize,
}

impl Network {
    /// Reads a TFLite file. Only what the outputs with these names depend on is read.
    ///
    /// # Errors
    /// [`NetworkError`] when the file is damaged, larger than the limits, or uses what is not built in.
    pub fn read(bytes: &[u8], outputs: &[&str]) -> Result<Self, NetworkError> {
        let plan = Plan::of(tflite::read(bytes, outputs)?);
        Ok(Self { plan: Arc::new(plan), slots: Vec::new() })
    }

    /// Height, width and channels of the input.
    #[must_use]
    pub fn input_shape(&self) -> [usize; 3] {
        self.plan.input_shape
    }

    /// Runs the network; returns its outputs in the order of their names. `input`: rows, then columns, then channels; what is
    /// missing of it is 0, what is too much is left out.
    pub fn run(&mut self, input: &[f32]) -> Vec<&[f32]> {
        let plan = &self.plan;
        self.slots.resize_with(plan.slots.len(), Vec::new);
        self.slots.iter_mut().zip(&plan.slots).for_each(|(slot, values)| slot.resize(*values, 0.0));
        let values = &mut self.slots[plan.input.slot][..plan.input.values];
        let given = input.len().min(values.len());
        values[..given].copy_from_slice(&input[..given]);
        values[given..].fill(0.0);
        for step in &plan.steps {
            let mut output = std::mem::take(&mut self.slots[step.output.slot]);
            let inputs: Vec<&[f32]> = step.inputs.iter().map(|place| place.of(&self.slots)).collect();
            step.operation.run(&inputs, &mut output[..step.output.values]);
            self.slots[step.output.slot] = output;
        }
        plan.outputs.iter().map(|place| place.of(&self.slots)).collect()
    }
}

impl Place {
    fn of(self, slots: &[Vec<f32>]) -> &[f32] {
        &slots[self.slot][..self.values]
    }
}

impl Plan {
    /// Gives each tensor a slot from when it is written until it was read for the last time.
    fn of(graph: tflite::Graph) -> Self {
        let mut slots = Slots::default();
        let last_use = |tensor: usize| graph.nodes.iter().rposition(|node| node.inputs.contains(&tensor));
        let mut places = std::collections::BTreeMap::new();
        let input = slots.take(graph.values[&graph.input]);
        places.insert(graph.input, input);
        let ends: Vec<Vec<usize>> = (0..graph.nodes.len())
            .map(|index| {
                let mut inputs = graph.nodes[index].inputs.clone();
                inputs.sort_unstable();
                inputs.dedup();
                inputs.retain(|tensor| last_use(*tensor) == Some(index) && !graph.outputs.contains(tensor));
                inputs
            })
            .collect();
        let mut steps = Vec::new();
        for (node, ends) in graph.nodes.into_iter().zip(ends) {
            let output = slots.take(graph.values[&node.output]);
            let inputs = node.inputs.iter().map(|tensor| places[tensor]).collect();
            places.insert(node.output, output);
            ends.iter().for_each(|tensor| slots.free.push(places[tensor].slot));
            steps.push(PlannedOperation { operation: node.operation, inputs, output });
        }
        let shape = graph.input_shape;
        Self {
            steps,
            slots: slots.sizes,
            input,
            input_shape: [shape.height, shape.width, shape.channels],
            outputs: graph.outputs.iter().map(|tensor| places[tensor]).collect(),
        }
    }
}

#[derive(Default)]
struct Slots {
    /// Values of each slot.
    sizes: Vec<usize>,
    /// Slots that nobody needs.
    free: Vec<usize>,
}

impl Slots {
    /// A slot for so many values: of the free ones the smallest that is large enough, or else the largest, which then grows.
    fn take(&mut self, values: usize) -> Place {
        let size = |slot: &usize| self.sizes[*slot];
        let enough = (0..self.free.len()).filter(|i| size(&self.free[*i]) >= values);
        let best = enough.min_by_key(|i| size(&self.free[*i]));
        let best = best.or_else(|| (0..self.free.len()).max_by_key(|i| size(&self.free[*i])));
        let slot = match best {
            Some(i) => self.free.swap_remove(i),
            None => {
                self.sizes.push(0);
                self.sizes.len() - 1
            }
        };
        self.sizes[slot] = self.sizes[slot].max(values);
        Place { slot, values }
    }
}

#[cfg(test)]
mod tests;

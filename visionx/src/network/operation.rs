//! The operations of a network other than convolutions.

use super::convolution::{Activation, Convolution, DepthwiseConvolution};
use super::window::{ImageShape, Window};

/// One operation on images of a fixed size.
#[derive(Debug)]
pub(super) enum Operation {
    Convolution(Convolution),
    Depthwise(DepthwiseConvolution),
    /// The largest value under the window, of each channel.
    MaxPool(Window),
    /// Negative values times a factor for each channel.
    Prelu(Vec<f32>),
    Activation(Activation),
    Logistic,
    /// The sum of two inputs of the same shape.
    Add(Activation),
    /// The image inside a larger one of zeros; the rows, columns and channels before it.
    Pad {
        input: ImageShape,
        before: [usize; 3],
        output: ImageShape,
    },
    /// Bilinear interpolation; pixels are squares whose centres are at halves.
    Resize {
        input: ImageShape,
        output: ImageShape,
    },
    /// Inputs one after the other, `pieces` values of each in turn.
    Concatenate(Vec<usize>),
    /// The mean of each channel.
    Mean(ImageShape),
    /// Groups of channels become blocks of pixels of this side.
    DepthToSpace {
        input: ImageShape,
        block: usize,
    },
    /// Another shape of the same values.
    Copy,
}

impl Operation {
    /// Runs it. The sizes of inputs and output were checked when the network was read.
    pub(super) fn run(&self, inputs: &[&[f32]], output: &mut [f32]) {
        let input = inputs[0];
        match self {
            Self::Convolution(convolution) => convolution.run(input, output),
            Self::Depthwise(convolution) => convolution.run(input, output),
            Self::MaxPool(window) => max_pool(window, input, output),
            Self::Prelu(factors) => {
                for (to, from) in
                    output.chunks_exact_mut(factors.len()).zip(input.chunks_exact(factors.len()))
                {
                    for ((to, from), factor) in to.iter_mut().zip(from).zip(factors) {
                        *to = if *from < 0.0 { from * factor } else { *from };
                    }
                }
            }
            Self::Activation(activation) => {
                output.copy_from_slice(input);
                activation.apply(output);
            }
            Self::Logistic => output.iter_mut().zip(input).for_each(|(to, from)| *to = sigmoid(*from)),
            Self::Add(activation) => {
                output.iter_mut().zip(input).zip(inputs[1]).for_each(|((to, a), b)| *to = a + b);
                activation.apply(output);
            }
            Self::Pad { input: shape, before, output: into } => pad(*shape, *before, *into, input, output),
            Self::Resize { input: shape, output: into } => resize(*shape, *into, input, output),
            Self::Concatenate(pieces) => {
                let mut to = output;
                let mut turn = 0;
                while !to.is_empty() {
                    for (input, piece) in inputs.iter().zip(pieces) {
                        let (here, rest) = to.split_at_mut(*piece);
                        here.copy_from_slice(&input[turn * piece..][..*piece]);
                        to = rest;
                    }
                    turn += 1;
                }
            }
            Self::Mean(shape) => {
                output.fill(0.0);
                for pixel in input.chunks_exact(shape.channels) {
                    output.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += value);
                }
                let count = (shape.height * shape.width) as f32;
                output.iter_mut().for_each(|sum| *sum /= count);
            }
            Self::DepthToSpace { input: shape, block } => depth_to_space(*shape, *block, input, output),
            Self::Copy => output.copy_from_slice(input),
        }
    }
}

/// `1 / (1 + e^-x)`, with an exponential function that is the same on every machine.
pub(crate) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + libm::expf(-x))
}

fn max_pool(window: &Window, input: &[f32], output: &mut [f32]) {
    let (channels, width) = (window.input.channels, window.input.width);
    for (place, most) in output.chunks_exact_mut(channels).enumerate() {
        most.fill(f32::NEG_INFINITY);
        let ([rows, columns], [row, column]) = window.inside(place);
        for y in row..row + rows.len() {
            let pixels = &input[(y * width + column) * channels..][..columns.len() * channels];
            for pixel in pixels.chunks_exact(channels) {
                most.iter_mut().zip(pixel).for_each(|(most, value)| *most = most.max(*value));
            }
        }
    }
}

fn pad(shape: ImageShape, before: [usize; 3], into: ImageShape, input: &[f32], output: &mut [f32]) {
    output.fill(0.0);
    for (i, pixel) in input.chunks_exact(shape.channels).enumerate() {
        let (y, x) = (i / shape.width + before[0], i % shape.width + before[1]);
        let at = (y * into.width + x) * into.channels + before[2];
        output[at..at + shape.channels].copy_from_slice(pixel);
    }
}

/// The two rows (or columns) between which an output lies, and how far it is on the way to the second.
fn between(at: usize, from: usize, to: usize) -> (usize, usize, f32) {
    let source = ((at as f32 + 0.5) * (from as f32 / to as f32) - 0.5).max(0.0);
    let first = (source as usize).min(from - 1);
    (first, (first + 1).min(from - 1), source - first as f32)
}

fn resize(shape: ImageShape, into: ImageShape, input: &[f32], output: &mut [f32]) {
    let pixel = |y: usize, x: usize| &input[(y * shape.width + x) * shape.channels..][..shape.channels];
    for (place, to) in output.chunks_exact_mut(shape.channels).enumerate() {
        let (top, bottom, down) = between(place / into.width, shape.height, into.height);
        let (left, right, along) = between(place % into.width, shape.width, into.width);
        let corners =
            pixel(top, left).iter().zip(pixel(top, right)).zip(pixel(bottom, left)).zip(pixel(bottom, right));
        for (to, (((a, b), c), d)) in to.iter_mut().zip(corners) {
            let (upper, lower) = (a + (b - a) * along, c + (d - c) * along);
            *to = upper + (lower - upper) * down;
        }
    }
}

fn depth_to_space(shape: ImageShape, block: usize, input: &[f32], output: &mut [f32]) {
    let channels = shape.channels / (block * block);
    for (i, pixel) in input.chunks_exact(shape.channels).enumerate() {
        let (y, x) = (i / shape.width * block, i % shape.width * block);
        for (j, piece) in pixel.chunks_exact(channels).enumerate() {
            let at = ((y + j / block) * shape.width * block + x + j % block) * channels;
            output[at..at + channels].copy_from_slice(piece);
        }
    }
}

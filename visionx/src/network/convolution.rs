//! Convolutions: nearly all the time of a network goes into them.
//!
//! The loops are vectorised over channels of the output, never over the terms of a sum: each output is the sum of its terms in
//! their order, with one rounding a product and one an addition. So the width of the machine's registers changes no bit. The vectors
//! are written out, as what a compiler finds by itself hangs on how a crate is split for it.

use std::ops::Range;

use wide::f32x8;

use super::NetworkError;
use super::window::{ImageShape, Window};

/// Outputs that are computed together: two registers of 128 bits.
const LANES: usize = 8;
/// Pixels that are computed together; with [`LANES`] channels their sums fill half of the registers.
const TILE: usize = 4;

/// What is done with each value at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Activation {
    None,
    /// Negative values become 0.
    Relu,
    /// The same, and values above 6 become 6.
    Relu6,
}

impl Activation {
    pub(super) fn apply(self, values: &mut [f32]) {
        match self {
            Self::None => {}
            Self::Relu => values.iter_mut().for_each(|v| *v = v.max(0.0)),
            Self::Relu6 => values.iter_mut().for_each(|v| *v = v.clamp(0.0, 6.0)),
        }
    }
}

/// A convolution of all channels with all.
#[derive(Debug)]
pub(super) struct Convolution {
    window: Window,
    outputs: usize,
    /// For each group of [`LANES`] outputs, for each input of the window, a weight for each of them.
    weights: Vec<[f32; LANES]>,
    bias: Vec<[f32; LANES]>,
    activation: Activation,
}

impl Convolution {
    /// `weights`: outputs x rows x columns x channels; `bias`: one value an output.
    pub(super) fn new(
        window: Window,
        weights: &[f32],
        bias: &[f32],
        activation: Activation,
    ) -> Result<Self, NetworkError> {
        let (outputs, terms) = (bias.len(), window.size[0] * window.size[1] * window.input.channels);
        if outputs == 0 || terms == 0 || Some(weights.len()) != outputs.checked_mul(terms) {
            return Err(NetworkError::Shape);
        }
        let mut packed = vec![[0.0; LANES]; outputs.div_ceil(LANES) * terms];
        for (output, weights) in weights.chunks_exact(terms).enumerate() {
            let group = &mut packed[output / LANES * terms..][..terms];
            group.iter_mut().zip(weights).for_each(|(lanes, weight)| lanes[output % LANES] = *weight);
        }
        let mut lanes = vec![[0.0; LANES]; outputs.div_ceil(LANES)];
        bias.iter().enumerate().for_each(|(i, bias)| lanes[i / LANES][i % LANES] = *bias);
        Ok(Self { window, outputs, weights: packed, bias: lanes, activation })
    }

    pub(super) fn shape(&self) -> ImageShape {
        let [height, width] = self.window.output;
        ImageShape { height, width, channels: self.outputs }
    }

    /// Products in one run.
    pub(super) fn products(&self) -> usize {
        self.window.places().saturating_mul(self.weights.len()).saturating_mul(LANES)
    }

    pub(super) fn run(&self, input: &[f32], output: &mut [f32]) {
        let terms = self.window.size[0] * self.window.size[1] * self.window.input.channels;
        let mut patches = vec![0.0; if self.window.is_pixelwise() { 0 } else { TILE * terms }];
        for (tile, outputs) in output.chunks_mut(TILE * self.outputs).enumerate() {
            let (first, count) = (tile * TILE, outputs.len() / self.outputs);
            let inputs = match self.window.is_pixelwise() {
                true => &input[first * terms..(first + count) * terms],
                false => {
                    for (i, patch) in patches.chunks_exact_mut(terms).take(count).enumerate() {
                        self.patch(input, first + i, patch);
                    }
                    &patches[..count * terms]
                }
            };
            // The last tile may be smaller: its last pixel is computed several times.
            let rows: [&[f32]; TILE] = std::array::from_fn(|i| &inputs[i.min(count - 1) * terms..][..terms]);
            for (group, (weights, bias)) in self.weights.chunks_exact(terms).zip(&self.bias).enumerate() {
                let sums = tile_sums(rows, weights, bias);
                let (from, to) = (group * LANES, (group * LANES + LANES).min(self.outputs));
                for (pixel, sums) in outputs.chunks_exact_mut(self.outputs).zip(&sums) {
                    pixel[from..to].copy_from_slice(&sums[..to - from]);
                }
            }
        }
        self.activation.apply(output);
    }

    /// Copies what the window covers at a place; 0 outside of the image.
    fn patch(&self, input: &[f32], place: usize, patch: &mut [f32]) {
        let ([rows, columns], [row, column]) = self.window.inside(place);
        let (channels, width) = (self.window.input.channels, self.window.input.width);
        patch.fill(0.0);
        let length = columns.len() * channels;
        for (y, r) in rows.enumerate() {
            let from = ((row + y) * width + column) * channels;
            let to = (r * self.window.size[1] + columns.start) * channels;
            patch[to..to + length].copy_from_slice(&input[from..from + length]);
        }
    }
}

/// The sums of [`TILE`] pixels for [`LANES`] outputs.
fn tile_sums(rows: [&[f32]; TILE], weights: &[[f32; LANES]], bias: &[f32; LANES]) -> [[f32; LANES]; TILE] {
    let mut sums = [f32x8::from(*bias); TILE];
    let [a, b, c, d] = rows;
    for ((((weights, a), b), c), d) in weights.iter().zip(a).zip(b).zip(c).zip(d) {
        let weights = f32x8::from(*weights);
        for (sum, x) in sums.iter_mut().zip([a, b, c, d]) {
            *sum += f32x8::splat(*x) * weights;
        }
    }
    sums.map(f32x8::to_array)
}

/// [`LANES`] values from a place on.
fn load(values: &[f32], first: usize) -> f32x8 {
    let mut lanes = [0.0; LANES];
    lanes.copy_from_slice(&values[first..first + LANES]);
    f32x8::from(lanes)
}

/// A convolution of each channel by itself.
#[derive(Debug)]
pub(super) struct DepthwiseConvolution {
    window: Window,
    /// Rows x columns x channels of the window.
    weights: Vec<f32>,
    bias: Vec<f32>,
    activation: Activation,
}

impl DepthwiseConvolution {
    /// `weights`: rows x columns x channels; `bias`: one value a channel.
    pub(super) fn new(
        window: Window,
        weights: &[f32],
        bias: &[f32],
        activation: Activation,
    ) -> Result<Self, NetworkError> {
        let channels = window.input.channels;
        let expected = (window.size[0] * window.size[1]).checked_mul(channels);
        if bias.len() != channels || channels == 0 || Some(weights.len()) != expected {
            return Err(NetworkError::Shape);
        }
        Ok(Self { window, weights: weights.to_vec(), bias: bias.to_vec(), activation })
    }

    pub(super) fn shape(&self) -> ImageShape {
        let [height, width] = self.window.output;
        ImageShape { height, width, ..self.window.input }
    }

    /// Products in one run.
    pub(super) fn products(&self) -> usize {
        self.window.places().saturating_mul(self.weights.len())
    }

    pub(super) fn run(&self, input: &[f32], output: &mut [f32]) {
        let channels = self.window.input.channels;
        for (place, sums) in output.chunks_exact_mut(channels).enumerate() {
            let (pixels, covered) = self.covered(place);
            let row = |(inputs, weights): (usize, Range<usize>)| {
                (&input[inputs..][..weights.len()], &self.weights[weights])
            };
            let rows = || covered.clone().map(row);
            let (lanes, rest) = sums.as_chunks_mut::<LANES>();
            let whole = channels - rest.len();
            for (first, sums) in (0..).step_by(LANES).zip(lanes) {
                let mut sum = load(&self.bias, first);
                for (inputs, weights) in rows() {
                    for at in (first..).step_by(channels).take(pixels) {
                        sum += load(inputs, at) * load(weights, at);
                    }
                }
                *sums = sum.to_array();
            }
            for (first, sum) in (whole..).zip(rest) {
                *sum = self.bias[first];
                for (inputs, weights) in rows() {
                    for at in (first..).step_by(channels).take(pixels) {
                        *sum += inputs[at] * weights[at];
                    }
                }
            }
        }
        self.activation.apply(output);
    }

    /// How many pixels of a row the window covers at a place; and of each row that it covers, where its inputs begin and which weights
    /// are theirs.
    fn covered(&self, place: usize) -> (usize, impl Iterator<Item = (usize, Range<usize>)> + Clone + use<>) {
        let ([rows, columns], [row, column]) = self.window.inside(place);
        let (channels, width, size) =
            (self.window.input.channels, self.window.input.width, self.window.size[1]);
        let (pixels, first) = (columns.len(), columns.start);
        let covered = rows.enumerate().map(move |(y, r)| {
            let weights = (r * size + first) * channels;
            (((row + y) * width + column) * channels, weights..weights + pixels * channels)
        });
        (pixels, covered)
    }
}

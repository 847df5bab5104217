//! Convolutions: nearly all the time of a network goes into them.
//!
//! The loops are vectorised over channels of the output, never over the terms of a sum: each output is the sum of its terms in
//! their order, with one rounding a product and one an addition. So the width of the machine's registers changes no bit. The vectors
//! are written out ([`Lanes`]), as what a compiler finds by itself hangs on how a crate is split for it.

use std::ops::Range;

use super::NetworkError;
use super::lanes::{LANES, Lanes, OnLanes, on_widest};
use super::window::{ImageShape, Window};

/// Pixels that are computed together.
const TILE: usize = 4;
/// Vectors that are computed together: as no sum waits for another, the processor works on all at once.
const PAIR: usize = 2;
const FOUR: usize = 4;

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

/// Numbers for outputs that are computed together.
type Group = [[f32; LANES]; PAIR];
/// Their number.
const GROUP: usize = PAIR * LANES;

/// A convolution of all channels with all.
#[derive(Debug)]
pub(super) struct Convolution {
    window: Window,
    outputs: usize,
    /// For each group of outputs, for each input of the window, a weight for each of them.
    weights: Vec<Group>,
    bias: Vec<Group>,
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
        let groups = outputs.div_ceil(GROUP);
        let mut packed = vec![Group::default(); groups * terms];
        for (output, weights) in weights.chunks_exact(terms).enumerate() {
            let of_group = packed[output / GROUP * terms..].iter_mut();
            of_group
                .zip(weights)
                .for_each(|(group, weight)| group.as_flattened_mut()[output % GROUP] = *weight);
        }
        let mut biases = vec![Group::default(); groups];
        biases.as_flattened_mut().as_flattened_mut()[..outputs].copy_from_slice(bias);
        Ok(Self { window, outputs, weights: packed, bias: biases, activation })
    }

    pub(super) fn shape(&self) -> ImageShape {
        let [height, width] = self.window.output;
        ImageShape { height, width, channels: self.outputs }
    }

    /// Products in one run.
    pub(super) fn products(&self) -> usize {
        self.window.places().saturating_mul(self.weights.len()).saturating_mul(GROUP)
    }

    pub(super) fn run(&self, input: &[f32], output: &mut [f32]) {
        on_widest(Run { of: self, input, output });
    }

    #[inline(always)]
    pub(super) fn run_on<L: Lanes>(&self, lanes: L, input: &[f32], output: &mut [f32]) {
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
                let (from, to) = (group * GROUP, (group * GROUP + GROUP).min(self.outputs));
                if L::EIGHT_SUMS && to - from > LANES {
                    let pixels = outputs.chunks_exact_mut(self.outputs).map(|pixel| &mut pixel[from..to]);
                    tile_sums::<L, PAIR>(lanes, rows, (weights, bias), 0, pixels);
                    continue;
                }
                for (vector, from) in (from..to).step_by(LANES).enumerate() {
                    let to = to.min(from + LANES);
                    let pixels = outputs.chunks_exact_mut(self.outputs).map(|pixel| &mut pixel[from..to]);
                    tile_sums::<L, 1>(lanes, rows, (weights, bias), vector, pixels);
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

/// A layer at work.
struct Run<'a, T> {
    of: &'a T,
    input: &'a [f32],
    output: &'a mut [f32],
}

impl OnLanes for Run<'_, Convolution> {
    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        self.of.run_on(lanes, self.input, self.output);
    }
}

/// The sums of [`TILE`] pixels for `N` vectors of a group of outputs, from one on, written to those that there are.
#[inline(always)]
fn tile_sums<'a, L: Lanes, const N: usize>(
    lanes: L,
    rows: [&[f32]; TILE],
    (weights, bias): (&[Group], &Group),
    first: usize,
    pixels: impl Iterator<Item = &'a mut [f32]>,
) {
    let mut sums = [std::array::from_fn::<_, N, _>(|i| lanes.load(bias[first + i])); TILE];
    let [a, b, c, d] = rows;
    for ((((weights, a), b), c), d) in weights.iter().zip(a).zip(b).zip(c).zip(d) {
        let weights: [_; N] = std::array::from_fn(|i| lanes.load(weights[first + i]));
        for (sums, x) in sums.iter_mut().zip([a, b, c, d]) {
            let x = lanes.splat(*x);
            for (sum, weight) in sums.iter_mut().zip(weights) {
                *sum = lanes.add_product(*sum, x, weight);
            }
        }
    }
    for (pixel, sums) in pixels.zip(sums) {
        let sums = sums.map(|sum| lanes.store(sum));
        pixel.copy_from_slice(&sums.as_flattened()[..pixel.len()]);
    }
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
        on_widest(Run { of: self, input, output });
    }

    #[inline(always)]
    pub(super) fn run_on<L: Lanes>(&self, lanes: L, input: &[f32], output: &mut [f32]) {
        let channels = self.window.input.channels;
        for (place, sums) in output.chunks_exact_mut(channels).enumerate() {
            let (pixels, covered) = self.covered(place);
            let row = |(inputs, weights): (usize, Range<usize>)| {
                (&input[inputs..][..weights.len()], &self.weights[weights])
            };
            let rows = || covered.clone().map(row);
            let (vectors, rest) = sums.as_chunks_mut::<LANES>();
            let whole = channels - rest.len();
            let (fours, vectors) = vectors.as_chunks_mut::<FOUR>();
            for (first, sums) in (0..).step_by(FOUR * LANES).zip(fours) {
                *sums = self.sums(lanes, first, rows(), pixels);
            }
            let first = whole - vectors.len() * LANES;
            for (first, sums) in (first..).step_by(LANES).zip(vectors) {
                [*sums] = self.sums(lanes, first, rows(), pixels);
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

    /// The sums of `N` vectors of channels, from one on, over the rows that the window covers at a place.
    #[inline(always)]
    fn sums<'a, L: Lanes, const N: usize>(
        &self,
        lanes: L,
        first: usize,
        rows: impl Iterator<Item = (&'a [f32], &'a [f32])>,
        pixels: usize,
    ) -> [[f32; LANES]; N] {
        let mut sums = std::array::from_fn(|i| lanes.load(eight(&self.bias, first + i * LANES)));
        for (inputs, weights) in rows {
            for at in (first..).step_by(self.bias.len()).take(pixels) {
                let (inputs, weights) = (&inputs[at..][..N * LANES], &weights[at..][..N * LANES]);
                for (i, sum) in sums.iter_mut().enumerate() {
                    let [value, weight] = [inputs, weights].map(|of| lanes.load(eight(of, i * LANES)));
                    *sum = lanes.add_product(*sum, value, weight);
                }
            }
        }
        sums.map(|sum| lanes.store(sum))
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

impl OnLanes for Run<'_, DepthwiseConvolution> {
    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        self.of.run_on(lanes, self.input, self.output);
    }
}

/// [`LANES`] values from a place on.
#[inline(always)]
fn eight(values: &[f32], first: usize) -> [f32; LANES] {
    let mut eight = [0.0; LANES];
    eight.copy_from_slice(&values[first..first + LANES]);
    eight
}

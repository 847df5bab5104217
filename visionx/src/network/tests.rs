use proptest::prelude::*;

use super::convolution::{Activation, Convolution, DepthwiseConvolution};
use super::lanes::Common;
use super::window::{ImageShape, Padding, Window};
use super::*;

const PALMS: &[u8] = include_bytes!("../../models/palm_detection_full.tflite");

/// Numbers from -1 to 1.
fn numbers(count: usize, seed: u32) -> Vec<f32> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 23) as f32 - 1.0
    };
    (0..count).map(|_| next()).collect()
}

/// A convolution by its definition, in double precision: at each place and output the sum over the window. `depthwise`: each channel by itself.
fn by_definition(
    (window, stride, before): ([usize; 2], usize, [usize; 2]),
    shape: ImageShape,
    places: [usize; 2],
    (weights, bias): (&[f32], &[f32]),
    depthwise: bool,
    input: &[f32],
) -> Vec<f64> {
    let inside = |at: usize, length: usize| (at < length).then_some(at);
    let mut sums = Vec::new();
    for (y, x, output) in (0..places[0])
        .flat_map(|y| (0..places[1]).map(move |x| (y, x)))
        .flat_map(|(y, x)| (0..bias.len()).map(move |output| (y, x, output)))
    {
        let mut sum = f64::from(bias[output]);
        for (row, column) in (0..window[0]).flat_map(|row| (0..window[1]).map(move |column| (row, column))) {
            let at = [y * stride + row, x * stride + column];
            let (Some(v), Some(u)) = (at[0].checked_sub(before[0]), at[1].checked_sub(before[1])) else {
                continue;
            };
            let (Some(v), Some(u)) = (inside(v, shape.height), inside(u, shape.width)) else { continue };
            let pixel = &input[(v * shape.width + u) * shape.channels..][..shape.channels];
            let tap = row * window[1] + column;
            for (channel, value) in
                pixel.iter().enumerate().filter(|(channel, _)| !depthwise || *channel == output)
            {
                let weight = match depthwise {
                    true => weights[tap * shape.channels + channel],
                    false => weights[(output * window[0] * window[1] + tap) * shape.channels + channel],
                };
                sum += f64::from(*value) * f64::from(weight);
            }
        }
        sums.push(sum);
    }
    sums
}

proptest! {
    #[test]
    fn convolutions_are_what_they_are_defined_as(
        height in 1usize..9, width in 1usize..9, channels in 1usize..42, outputs in 1usize..42,
        size in 1usize..4, stride in 1usize..3, same: bool, seed: u32,
    ) {
        let shape = ImageShape { height, width, channels };
        let padding = if same { Padding::Same } else { Padding::Valid };
        let window = Window::new(shape, [size, size], [stride, stride], padding);
        prop_assume!(same || (size <= height && size <= width));
        let window = window.unwrap();
        let before = [height, width].map(|length| match same {
            // As many before as behind the image, the odd one behind.
            true => ((length.div_ceil(stride) - 1) * stride + size).saturating_sub(length) / 2,
            false => 0,
        });
        let input = numbers(height * width * channels, seed);
        for depthwise in [false, true] {
            let outputs = if depthwise { channels } else { outputs };
            let weights = numbers(size * size * channels * if depthwise { 1 } else { outputs }, seed ^ 1);
            let bias = numbers(outputs, seed ^ 2);
            // By the widest vectors of this processor, and by those that each has.
            let mut output = vec![f32::NAN; window.places() * outputs];
            let mut common = output.clone();
            if depthwise {
                let layer = DepthwiseConvolution::new(window, &weights, &bias, Activation::None).unwrap();
                layer.run(&input, &mut output);
                layer.run_on(Common, &input, &mut common);
            } else {
                let layer = Convolution::new(window, &weights, &bias, Activation::None).unwrap();
                layer.run(&input, &mut output);
                layer.run_on(Common, &input, &mut common);
            }
            prop_assert_eq!(&output, &common);
            let geometry = ([size, size], stride, before);
            let expected = by_definition(geometry, shape, window.output, (&weights, &bias), depthwise, &input);
            prop_assert_eq!(output.len(), expected.len());
            for (value, expected) in output.iter().zip(&expected) {
                // Some 400 roundings of sums below 100.
                prop_assert!((f64::from(*value) - expected).abs() < 1e-4, "{} {}", value, expected);
            }
        }
    }
}

#[test]
fn the_same_input_gives_the_same_bits() {
    let mut network = Network::read(PALMS, &["Identity"]).unwrap();
    let input = numbers(network.input_shape().iter().product(), 7);
    let first = network.run(&input)[0].to_vec();
    // Slots are shared: what an earlier run has left in them must not matter.
    network.run(&numbers(input.len(), 8));
    assert_eq!(network.run(&input)[0], first);
    assert_eq!(Network::read(PALMS, &["Identity"]).unwrap().run(&input)[0], first);
    assert_eq!(network.run(&[]).len(), 1);
}

fn refused(file: &[u8]) -> NetworkError {
    Network::read(file, &["Identity"]).expect_err("it is refused")
}

#[test]
fn what_is_no_network_is_refused() {
    assert!(matches!(refused(b""), NetworkError::NotTflite));
    assert!(matches!(refused(b"\x89PNG\r\n\x1a\n and so on"), NetworkError::NotTflite));
    assert!(matches!(refused(b"\0\0\0\0TFL3"), NetworkError::Damaged));
    let missing = Network::read(PALMS, &["Handedness"]).expect_err("there is no such output");
    assert_eq!(missing.to_string(), "the file has no output `Handedness`");
    // The last tables of the file are metadata, which are not needed.
    for length in (0..PALMS.len() - 60_000).step_by(PALMS.len() / 40) {
        refused(&PALMS[..length]);
    }
}

#[test]
fn a_damaged_file_ends_nothing() {
    let tables = PALMS.len() - 60_000;
    let mut state = 3u32;
    let mut draw = |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 4) as usize % below
    };
    let mut refused = 0;
    for i in 0..300 {
        let mut file = PALMS.to_vec();
        // The tables are at the end of the file.
        let at = if i % 3 == 0 { draw(file.len()) } else { tables + draw(60_000) };
        file[at] = [0, 1, 127, 255, draw(256) as u8][i % 5];
        refused += usize::from(Network::read(&file, &["Identity", "Identity_1"]).is_err());
    }
    assert!(refused > 20, "{refused}");
}

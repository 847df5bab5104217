//! The networks that ship are the files that `models/NOTICE.md` names, and they compute what another implementation computes.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use armarium_visionx::network::Network;
use sha2::{Digest, Sha256};

fn models() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("models")
}

#[test]
fn each_file_has_its_checksum_in_the_notice() {
    let notice = fs::read_to_string(models().join("NOTICE.md")).expect("it is in the repository");
    let mut files = 0;
    for file in fs::read_dir(models()).expect("it is in the repository").filter_map(Result::ok) {
        let name = file.file_name().into_string().expect("it is text");
        if name == "NOTICE.md" {
            continue;
        }
        let digest = Sha256::digest(fs::read(file.path()).expect("it can be read"));
        let digest: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
        assert!(notice.lines().any(|line| line.contains(&name) && line.contains(&digest)), "{name} {digest}");
        files += 1;
    }
    assert!(files >= 2);
}

/// The input for which `litert.txt` was recorded: bytes of a linear congruential generator, as brightness.
fn input(values: usize) -> Vec<f32> {
    let mut state = 1u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as f32 / 255.0
    };
    (0..values).map(|_| next()).collect()
}

#[test]
fn they_compute_what_litert_computes() {
    let recorded = include_str!("litert.txt");
    let mut expected: BTreeMap<(&str, &str), Vec<(usize, f32)>> = BTreeMap::new();
    for line in recorded.lines().filter(|line| !line.starts_with('#')) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [file, output, index, value] = words[..] else { panic!("{line}") };
        let value = (index.parse().expect("an index"), value.parse().expect("a value"));
        expected.entry((file, output)).or_default().push(value);
    }
    assert!(!expected.is_empty());
    for ((file, output), values) in expected {
        let bytes = fs::read(models().join(file)).expect("it is in the repository");
        let mut network = Network::read(&bytes, &[output]).expect("it is a network");
        let input = input(network.input_shape().iter().product());
        let computed = network.run(&input)[0];
        // Sums of a thousand products in another order: 20 roundings of the largest value. The landmarks of a body come out of so many
        // layers that LiteRT's own two implementations, with and without XNNPACK, differ by 360 for this input.
        let roundings = if file == "pose_landmark_full.tflite" { 400.0 } else { 20.0 };
        let largest = computed.iter().fold(1.0f32, |largest, value| largest.max(value.abs()));
        for (index, value) in values {
            let error = (computed[index] - value).abs();
            let most = roundings * f32::EPSILON * largest;
            assert!(error < most, "{file} {output} {index}: {error}");
        }
    }
}

//! How long the networks take for an image, on one thread, next to LiteRT (C++ with AVX) in the same run:
//! `cargo bench -p armarium-visionx --bench networks`. LiteRT comes from PyPI (`ai-edge-litert`); the variable `ARMARIUM_PYTHON`
//! names a Python that has it. Without one, only our own times are printed.

#![expect(clippy::disallowed_methods, reason = "it measures the machine")]
#![allow(clippy::print_stdout, reason = "a program for people")]

use std::error::Error;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use armarium_visionx::network::Network;

/// Runs of which the best counts.
const RUNS: usize = 40;
const ROUNDS: usize = 3;

/// Prints the best of some runs, ms.
const LITERT: &str = "
import sys, time, numpy
from ai_edge_litert.interpreter import Interpreter
network = Interpreter(sys.argv[1], num_threads=1)
network.allocate_tensors()
given = network.get_input_details()[0]
network.set_tensor(given['index'], numpy.full(given['shape'], 0.5, numpy.float32))
def run():
    start = time.perf_counter()
    network.invoke()
    return time.perf_counter() - start
print(1e3 * min(run() for _ in range(int(sys.argv[2]))))
";

fn litert(file: &Path) -> Option<f64> {
    let python = std::env::var("ARMARIUM_PYTHON").unwrap_or_else(|_| "python3".into());
    let out = Command::new(python).args(["-c", LITERT]).arg(file).arg(RUNS.to_string()).output().ok()?;
    String::from_utf8(out.stdout).ok()?.trim().parse().ok()
}

fn main() -> Result<(), Box<dyn Error>> {
    println!("best of {} runs, ms", RUNS * ROUNDS);
    for (name, outputs) in [
        ("palm_detection_full.tflite", &["Identity", "Identity_1"][..]),
        ("hand_landmark_full.tflite", &["Identity", "Identity_1", "Identity_3"]),
        ("pose_detection.tflite", &["Identity", "Identity_1"]),
        ("pose_landmark_full.tflite", &["Identity", "Identity_1", "Identity_4"]),
    ] {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("models").join(name);
        let mut network = Network::read(&std::fs::read(&file)?, outputs)?;
        let input = vec![0.5; network.input_shape().iter().product()];
        let (mut own, mut other) = (f64::INFINITY, None);
        for _ in 0..ROUNDS {
            for _ in 0..RUNS {
                let start = Instant::now();
                network.run(&input);
                own = own.min(start.elapsed().as_secs_f64() * 1e3);
            }
            other = litert(&file).map(|ms| other.map_or(ms, |best: f64| best.min(ms)));
        }
        match other {
            Some(other) => {
                println!("{name:<28} {own:6.1}, LiteRT {other:6.1}: {:.1} times as long", own / other)
            }
            None => println!("{name:<28} {own:6.1}, LiteRT is not installed"),
        }
    }
    Ok(())
}

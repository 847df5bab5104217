//! Learns how fingertips move: from sequences of images, in which tips are found and linked, and from simulated
//! hands, whose tips are known.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::Path;

use armarium_experiments::fingertips::{RATE_HZ, simulated_paths};
use armarium_visionx::tracking::{FingerARModel, TipFollower};
use nalgebra::Point2;

use super::TrainArgs;
use super::sequence::Sequence;
use crate::failure::CommandFailure;

/// The positions of one fingertip, frame by frame, normalised; not finite where it was not seen.
type Path2 = Vec<Point2<f64>>;

/// Learns and saves. Returns 2 when there is no data to learn from, 1 when the model cannot be written.
pub(super) fn run(args: &TrainArgs, out: &mut dyn Write) -> Result<u8, CommandFailure> {
    let mut paths = Vec::new();
    for folder in &args.folders {
        paths.extend(seen(folder, args)?);
    }
    if let Some(sequences) = args.simulated {
        if (args.rate - RATE_HZ).abs() > 1e-9 {
            return Err(format!("simulated sequences have {RATE_HZ} images a second").into());
        }
        paths.extend((0..sequences).flat_map(simulated_paths));
    }
    let model = FingerARModel::fit(&paths, args.rate).map_err(|error| error.to_string())?;
    let shown = args.output.display();
    fs::write(&args.output, model.to_yaml())
        .map_err(|error| CommandFailure::Refused(format!("{shown}: {error}")))?;
    let deviation = model.noise.diagonal().map(f64::sqrt);
    writeln!(
        out,
        "{shown}: learned from {} steps of {} fingertips; a step is off by {:.5} across and {:.5} down",
        model.samples,
        paths.len(),
        deviation.x,
        deviation.y,
    )?;
    Ok(0)
}

/// The paths of the tips in a sequence of images.
fn seen(path: &Path, args: &TrainArgs) -> Result<Vec<Path2>, String> {
    let sequence = Sequence::open(path, None)?;
    let walk = FingerARModel::random_walk(0.02, args.rate);
    let mut follower = TipFollower::new(args.detector.of_sequence(), walk, args.focal);
    let mut paths: BTreeMap<u64, Path2> = BTreeMap::new();
    sequence.each(|(_, image)| {
        let Ok(image) = image else { return true };
        let seen = follower.update(&image);
        for node in seen.nodes.iter().filter(|n| n.unseen == 0) {
            // The candidate itself, not the filter's mean: the mean would teach the filter its own smoothing.
            let tips = seen.hand.iter().flat_map(|h| &h.fingertips).map(|t| t.px);
            let own = tips.min_by(|a, b| (a - node.px).norm().total_cmp(&(b - node.px).norm()));
            if let Some(px) = own {
                let normalised = |i: usize| (px[i] - seen.center[i]) / seen.focal;
                paths.entry(node.id).or_default().push(Point2::new(normalised(0), normalised(1)));
            }
        }
        true
    })?;
    Ok(paths.into_values().collect())
}

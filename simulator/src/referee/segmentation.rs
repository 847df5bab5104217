//! The probe `segmentation`: what the robot's memory takes for things of their own, against the pixels that show each thing.
//!
//! Masks are compared in the left eye, in the first picture of which memory says something and in the last one. The robot's own arms
//! are not drawn for it: it is to look when they are aside.

use armarium_values::report::Requirement::{AtLeast, AtMost, Shown};
use armarium_values::report::{Block, Cell, Figure, Section};
use armarium_visionx::PinholeCamera;
use nalgebra::Isometry3;
use serde::Serialize;
use serde_json::Value;

use super::Milestone;
use super::log::KnownHypothesis;
use super::probes::{Probe, cell, figure, table_of};
use super::run::JudgedRun;
use crate::render::robot::link_shapes;
use crate::render::{ExposureMotion, Viewpoint, VisibleScene, depth_of_shapes};
use crate::truth::FrameTruth;
use crate::world::BodyMotion;

pub(super) const PROBE: Probe = Probe { name: "segmentation", measure, asks, section };

/// Fewer pixels of a thing are not seen; a hypothesis beyond the things counts from so many on.
const SEEN: usize = 100;
const FURTHER: usize = 500;
/// What is asked: of the mean, of the share of things that are over a bound, of the first hypotheses, of the gain, of pushes a thing.
const MEAN: f64 = 0.85;
const OVER: (f64, f64) = (0.75, 0.9);
const FIRST: f64 = 0.5;
const GAIN: f64 = 0.2;
const PUSHES: f64 = 3.0;
/// What is lower than it was by more than this has fallen, m.
const FALLEN: f64 = 0.2;

#[derive(Clone, Debug, PartialEq, Serialize)]
struct SegmentationFigures {
    things: Vec<ThingFigures>,
    /// Mean over things and further hypotheses, in the first picture and in the last.
    first_mean_iou: f64,
    mean_iou: f64,
    gain: f64,
    /// The share of them over 0.75 in the last picture.
    share_over: f64,
    /// Hypotheses of no thing of over 500 pixels, in the first picture and in the last.
    first_further: usize,
    further: usize,
    pushes: usize,
    pushes_per_thing: f64,
    /// Things that have fallen off the table.
    fallen: usize,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct ThingFigures {
    name: String,
    /// Pixels that show it in the last picture.
    pixels: usize,
    first_iou: f64,
    iou: f64,
    /// Whether what stands for it in memory has moved as one.
    confirmed: bool,
    /// The learned class of which that is taken to be.
    #[serde(skip_serializing_if = "Option::is_none")]
    class: Option<String>,
}

/// How the hypotheses of one picture fit.
struct HypothesisFit<'r> {
    /// Of each body its pixels, its IoU, and its hypothesis.
    of_bodies: Vec<(usize, f64, Option<&'r KnownHypothesis>)>,
    further: usize,
}

fn measure(run: &JudgedRun<'_>) -> Option<Value> {
    let stamps = || run.log.hypotheses.iter().filter(|(.., known)| known.is_some()).map(|(stamp, ..)| *stamp);
    let (first, last) = (fit(run, stamps().min()?)?, fit(run, stamps().max()?)?);
    let bodies: Vec<_> = run.world.named_bodies().collect();
    let loose = |index: &usize| bodies[*index].motion == BodyMotion::Free;
    let seen = |fit: &HypothesisFit<'_>, index: usize| fit.of_bodies[index].0 >= SEEN;
    let of_interest: Vec<usize> =
        (0..bodies.len()).filter(loose).filter(|&i| seen(&first, i) || seen(&last, i)).collect();
    let things: Vec<ThingFigures> = of_interest
        .iter()
        .map(|&index| {
            let (pixels, iou, known) = last.of_bodies[index];
            ThingFigures {
                name: bodies[index].name.clone(),
                pixels,
                first_iou: first.of_bodies[index].1,
                iou,
                confirmed: known.is_some_and(|known| known.confirmed),
                class: known.and_then(|known| known.class.clone()),
            }
        })
        .collect();
    if things.is_empty() {
        return None;
    }
    let mean = |sum: f64, further: usize| sum / (things.len() + further) as f64;
    let first_mean_iou = mean(things.iter().map(|thing| thing.first_iou).sum(), first.further);
    let mean_iou = mean(things.iter().map(|thing| thing.iou).sum(), last.further);
    let over = things.iter().filter(|thing| thing.iou > OVER.0).count();
    let pushes = run.marks().iter().filter(|(_, mark)| *mark == Milestone::ObjectPushed).count();
    let fallen = |index: &&usize| {
        run.log
            .begin_and_end(**index)
            .is_some_and(|(begin, end)| begin.translation.z - end.translation.z > FALLEN)
    };
    let figures = SegmentationFigures {
        first_mean_iou,
        mean_iou,
        gain: mean_iou - first_mean_iou,
        share_over: mean(over as f64, last.further),
        first_further: first.further,
        further: last.further,
        pushes,
        pushes_per_thing: pushes as f64 / things.len() as f64,
        fallen: of_interest.iter().filter(fallen).count(),
        things,
    };
    serde_json::to_value(figures).ok()
}

/// How what memory held of the picture of a time fits; `None` without such a picture.
fn fit<'r>(run: &JudgedRun<'r>, stamp_ns: u64) -> Option<HypothesisFit<'r>> {
    let frame = run.log.frames.iter().find(|frame| frame.stamp_ns == stamp_ns)?;
    let mut held = std::collections::BTreeMap::new();
    for (_, name, known) in run.log.hypotheses.iter().filter(|(stamp, ..)| *stamp == stamp_ns) {
        held.insert(name, known.as_ref());
    }
    let known: Vec<&KnownHypothesis> = held.into_values().flatten().collect();
    let shown = shown(run, frame);
    let bodies = run.world.named_bodies().count();
    let width = run.world.camera.width;
    let mut overlaps = vec![vec![0usize; bodies]; known.len()];
    let mut sizes = vec![0usize; known.len()];
    for ((hypothesis, overlaps), size) in known.iter().zip(&mut overlaps).zip(&mut sizes) {
        for [y, from, to] in &hypothesis.mask {
            for x in *from..*to {
                *size += 1;
                if let Some(body) = shown.get((y * width + x) as usize).copied().flatten() {
                    overlaps[body] += 1;
                }
            }
        }
    }
    let pixels: Vec<usize> =
        (0..bodies).map(|body| shown.iter().filter(|shown| **shown == Some(body)).count()).collect();
    let iou = |hypothesis: usize, body: usize| {
        let both = overlaps[hypothesis][body] as f64;
        both / ((sizes[hypothesis] + pixels[body]) as f64 - both).max(1.0)
    };
    let gains: Vec<Vec<f64>> =
        (0..known.len()).map(|h| (0..bodies).map(|body| iou(h, body)).collect()).collect();
    let matched = best_assignment(&gains, bodies);
    let of_bodies = (0..bodies).map(|body| {
        let own = (0..known.len()).find(|&h| matched[h] == Some(body));
        (pixels[body], own.map_or(0.0, |h| iou(h, body)), own.map(|h| known[h]))
    });
    let is_further = |h: &usize| matched[*h].is_none_or(|body| iou(*h, body) == 0.0) && sizes[*h] > FURTHER;
    Some(HypothesisFit {
        of_bodies: of_bodies.collect(),
        further: (0..known.len()).filter(is_further).count(),
    })
}

/// The body that each pixel of the left eye shows.
fn shown(run: &JudgedRun<'_>, frame: &FrameTruth) -> Vec<Option<usize>> {
    let spec = &run.world.camera;
    let center = [f64::from(spec.width) / 2.0, f64::from(spec.height) / 2.0];
    let camera = PinholeCamera { width: spec.width, height: spec.height, focal: spec.focal, center };
    let (scene_from_camera, motion) = (frame.root_from_left, ExposureMotion::default());
    let eye = Viewpoint { scene_from_camera, motion, camera };
    let mut nearest = vec![(f32::INFINITY, None); (spec.width * spec.height) as usize];
    for (index, body) in run.world.named_bodies().enumerate() {
        let pose = run.log.object_at(index, frame.stamp_ns).unwrap_or_else(Isometry3::identity);
        let depth = depth_of_shapes(&VisibleScene::new(link_shapes(&body.parts(), &pose)), &eye);
        for (depth, nearest) in depth.data.iter().zip(&mut nearest) {
            if *depth > 0.0 && *depth < nearest.0 {
                *nearest = (*depth, Some(index));
            }
        }
    }
    nearest.into_iter().map(|(_, body)| body).collect()
}

/// For each row of gains its column, each column at most once, so that the sum of the gains is the largest (Kuhn 1955 and Munkres
/// 1957, in the form with potentials and shortest augmenting paths of Jonker and Volgenant 1987).
fn best_assignment(gains: &[Vec<f64>], columns: usize) -> Vec<Option<usize>> {
    let size = gains.len().max(columns);
    let cost = |i: usize, j: usize| -gains.get(i).and_then(|row| row.get(j)).copied().unwrap_or(0.0);
    // Rows and columns count from 1; 0 is none.
    let (mut of_rows, mut of_columns) = (vec![0.0; size + 1], vec![0.0; size + 1]);
    let mut row_of = vec![0usize; size + 1];
    for row in 1..=size {
        let (mut least, mut used) = (vec![f64::INFINITY; size + 1], vec![false; size + 1]);
        let mut from = vec![0usize; size + 1];
        let mut column = 0;
        row_of[0] = row;
        while row_of[column] != 0 {
            used[column] = true;
            let (here, mut delta, mut next) = (row_of[column], f64::INFINITY, 0);
            for j in (1..=size).filter(|j| !used[*j]).collect::<Vec<_>>() {
                let reduced = cost(here - 1, j - 1) - of_rows[here] - of_columns[j];
                if reduced < least[j] {
                    (least[j], from[j]) = (reduced, column);
                }
                if least[j] < delta {
                    (delta, next) = (least[j], j);
                }
            }
            for j in 0..=size {
                if used[j] {
                    of_rows[row_of[j]] += delta;
                    of_columns[j] -= delta;
                } else {
                    least[j] -= delta;
                }
            }
            column = next;
        }
        while column != 0 {
            row_of[column] = row_of[from[column]];
            column = from[column];
        }
    }
    let mut columns_of = vec![None; gains.len()];
    for (column, row) in row_of.iter().enumerate().skip(1).filter(|(column, _)| *column <= columns) {
        if let Some(found) = columns_of.get_mut(row - 1) {
            *found = Some(column - 1);
        }
    }
    columns_of
}

fn asks(own: &Value) -> Vec<Figure> {
    let of = |name, key, unit, requirement| figure(("Segmentation", name), own, key, unit, requirement);
    vec![
        of("mean IoU", ("mean_iou", 1.0), ("", 2), AtLeast(MEAN)),
        of("things over 0.75", ("share_over", 1e2), ("%", 0), AtLeast(OVER.1 * 1e2)),
        of("mean IoU before any push", ("first_mean_iou", 1.0), ("", 2), AtLeast(FIRST)),
        of("gain by pushing", ("gain", 1.0), ("", 2), AtLeast(GAIN)),
        of("pushes a thing", ("pushes_per_thing", 1.0), ("", 1), AtMost(PUSHES)),
        of("hypotheses of no thing", ("further", 1.0), ("", 0), Shown),
        of("fallen off the table", ("fallen", 1.0), ("", 0), AtMost(0.0)),
    ]
}

fn section(_: &JudgedRun<'_>, own: &Value) -> Vec<Section> {
    if own.is_null() {
        return Vec::new();
    }
    let titles = ["thing", "#pixels", "#IoU at first", "#IoU", "moved as one", "taken for"];
    let table = table_of(&own["things"], &titles, |thing| {
        let text = |value: &Value| Cell::Text(value.as_str().unwrap_or("-").to_owned());
        vec![
            Cell::Code(thing["name"].as_str().unwrap_or_default().to_owned()),
            cell(thing, ("pixels", 1.0), "", 0),
            cell(thing, ("first_iou", 1.0), "", 2),
            cell(thing, ("iou", 1.0), "", 2),
            Cell::Text(if thing["confirmed"] == true { "yes" } else { "no" }.to_owned()),
            text(&thing["class"]),
        ]
    });
    let note = "What memory takes for things of their own, against the pixels that show each thing in the left eye: before any push, and at the end.";
    vec![Section::new("Things told apart", note, vec![Block::Table(table)])]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Tries all assignments.
    fn best_sum(gains: &[Vec<f64>], used: &mut Vec<bool>) -> f64 {
        let Some((first, rest)) = gains.split_first() else { return 0.0 };
        let mut best = best_sum(rest, used);
        for j in 0..used.len() {
            if !used[j] {
                used[j] = true;
                best = best.max(first[j] + best_sum(rest, used));
                used[j] = false;
            }
        }
        best
    }

    proptest! {
        #[test]
        fn no_assignment_is_better(
            (rows, columns) in (0..5usize, 0..5usize), numbers in proptest::collection::vec(0.0..1.0f64, 25),
        ) {
            let gains: Vec<Vec<f64>> = (0..rows).map(|i| numbers[i * 5..i * 5 + columns].to_vec()).collect();
            let found = best_assignment(&gains, columns);
            let sum: f64 = found.iter().enumerate().filter_map(|(i, j)| Some(gains[i][(*j)?])).sum();
            let taken: std::collections::BTreeSet<usize> = found.iter().flatten().copied().collect();
            prop_assert_eq!(taken.len(), found.iter().flatten().count());
            prop_assert!((sum - best_sum(&gains, &mut vec![false; columns])).abs() < 1e-9);
        }
    }
}

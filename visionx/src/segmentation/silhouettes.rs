//! The pixels that show each hypothesis: what rises over its cells, and along its borders, where depth is not measured, what has its colour.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point2, Point3};

use super::hypothesis::Hypothesis;
use super::top_view::{CellIndex, around, middle_of, place_of};
use crate::camera::PinholeCamera;
use crate::components::{components, fill_holes};
use crate::frame::{DepthImage, RgbImage};
use crate::mask::{Mask, PixelRun, Region, beside};
use crate::plane::Plane;

/// What is lower than this, m, may be the table.
const LOW: f64 = 0.005;
/// A pixel below this height, m, or without one may belong to a neighbour of its colour.
const UNSURE: f64 = 0.012;
/// So many cells beside a hypothesis its upright sides are seen.
const SIDES: i32 = 3;
/// What is higher than a hypothesis by more than this, m, is not of it.
const HIGHER: f64 = 0.012;
/// How far masks grow into unsure pixels, px, and how far colours of neighbours may differ, of 255.
const GROWTH: usize = 4;
const ALIKE: i32 = 28;
/// Smaller holes are filled, and smaller specks left out, px.
const HOLE: u32 = 200;
const SPECK: u32 = 12;

/// For each hypothesis the runs of pixels that show it.
pub(super) fn silhouettes(
    hypotheses: &[Hypothesis],
    (depth, colors): (&DepthImage, &RgbImage),
    camera: &PinholeCamera,
    root_from_left: &Isometry3<f64>,
    plane: &Plane,
) -> Vec<Vec<PixelRun>> {
    let size = [depth.width as usize, depth.height as usize];
    let owners: BTreeMap<CellIndex, usize> = hypotheses
        .iter()
        .enumerate()
        .flat_map(|(i, h)| h.cells.keys().map(move |place| (*place, i)))
        .collect();
    let mut labels: Vec<Option<usize>> = vec![None; size[0] * size[1]];
    let mut unsure = vec![true; labels.len()];
    for (x, y) in Region::whole(depth.width, depth.height).pixels() {
        let i = (y * depth.width + x) as usize;
        let z = f64::from(depth.data[i]);
        if z <= 0.0 {
            continue;
        }
        let at = root_from_left * Point3::from(camera.ray(&Point2::new(f64::from(x), f64::from(y))) * z);
        let height = plane.above(&at);
        unsure[i] = height < UNSURE;
        if height > LOW {
            labels[i] = owner(&owners, hypotheses, &at.xy(), height);
        }
    }
    for _ in 0..GROWTH {
        grow(&mut labels, &unsure, colors, size);
    }
    (0..hypotheses.len()).map(|of| runs(&labels, of, depth)).collect()
}

/// The hypothesis with the nearest cell that is high enough.
fn owner(
    owners: &BTreeMap<CellIndex, usize>,
    hypotheses: &[Hypothesis],
    at: &Point2<f64>,
    height: f64,
) -> Option<usize> {
    let here = place_of(at);
    let own = |place: CellIndex| {
        let of = *owners.get(&place)?;
        (height < hypotheses[of].cells[&place].height + HIGHER).then_some(of)
    };
    if let Some(of) = own(here) {
        return Some(of);
    }
    let near =
        around(here, SIDES).filter_map(|place| Some(((middle_of(place) - at).norm_squared(), own(place)?)));
    near.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, of)| of)
}

/// Gives each unsure pixel to a labelled one beside it of its colour.
fn grow(labels: &mut [Option<usize>], unsure: &[bool], colors: &RgbImage, size: [usize; 2]) {
    let color = |i: usize| colors.pixel((i % size[0]) as u32, (i / size[0]) as u32).map(i32::from);
    let mut grown = Vec::new();
    for i in (0..labels.len()).filter(|&i| labels[i].is_none() && unsure[i]) {
        let alike = |j: &usize| {
            let (a, b) = (color(i), color(*j));
            (0..3).all(|channel| (a[channel] - b[channel]).abs() < ALIKE)
        };
        let of = beside(i, size).filter(|&j| labels[j].is_some()).find(alike).and_then(|j| labels[j]);
        grown.extend(of.map(|of| (i, of)));
    }
    for (i, of) in grown {
        labels[i] = Some(of);
    }
}

fn runs(labels: &[Option<usize>], of: usize, depth: &DepthImage) -> Vec<PixelRun> {
    let region = Region::whole(depth.width, depth.height);
    let mut mask = Mask::of(region, labels.iter().map(|label| *label == Some(of)));
    fill_holes(&mut mask, HOLE);
    components(&mask, SPECK).into_iter().flat_map(|part| part.runs).collect()
}

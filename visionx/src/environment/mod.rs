//! What does not move by itself around the robot: tables, shelves, walls and the floor, as flat surfaces that are fused over time
//! from depth.
//!
//! Each picture adds to what is known of a surface: of its plane by recursive least squares with the covariance of the depths and
//! of where the camera was, of its extent cell by cell. A place of a surface behind which something is measured speaks against it,
//! so that what was taken away fades. What is solid and no surface is kept in a coarse grid. It knows no memory: whoever runs it tells
//! it what is remembered, and keeps what it tells.

mod grid;
mod step;
mod surface;

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector3};

use crate::camera::PinholeCamera;
use crate::frame::{DepthImage, StereoFrame};
use crate::own_part::OwnPart;
use crate::plane::{Plane, towards, upwards};
use crate::points::{DepthPoint, DepthPoints, uncertainty};
pub use grid::BulkEstimate;
use grid::Grid;
pub use step::EnvironmentStep;
use surface::{CELL, Surface, Visibility};

/// Every so many pixels the depth is sampled, and up to which depth, m.
const SAMPLED: (u32, f64) = (4, 3.5);
/// A near point that is nearer to a surface than this belongs to it, m.
const BAND: f64 = 0.012;
/// What is measured farther behind a surface than this was seen through it, m.
const BEHIND: f64 = 0.03;
/// Most surfaces; new ones beyond are not taken.
const MAX_SURFACES: usize = 32;
/// Most new surfaces in one picture.
const MAX_NEW: usize = 3;
/// A new surface has at least this share of the points that no surface explains, and at least so many points.
const MIN_SHARE: f64 = 0.05;
const MIN_POINTS: usize = 150;
/// Points of a new surface that are near stray from it by less than this, m: standard deviation.
const FLAT: f64 = 0.003;
/// Up to which depth what is solid and no surface is looked for, m.
const SOLID: f64 = 2.5;
/// What is nearer to a surface, at a near place, or to the robot's own body than this may be of that, m.
const MAY_BE_OF: (f64, f64) = (0.08, 0.05);
/// Takes the points that belong to no single surface.
const NOBODY: usize = usize::MAX;
/// A new surface is at least so large, m²: a level one, and an upright one.
const MIN_AREA: (f64, f64) = (0.04, 0.15);
/// A surface grows by at most so many cells at a time.
const GROWS: i16 = 2;
/// Surfaces are the same if their planes agree within this, m and rad, and they are at most so many cells apart.
const SAME: (f64, f64, i16) = (0.025, 0.07, 4);
/// Neighbours in the image within this of each other, m, belong together.
const CONNECTED: f64 = 0.15;
/// What is less probable is forgotten; what is more probable is told.
const FORGOTTEN: f64 = 0.2;
const TOLD: f64 = 0.8;
/// What is gone is told for so long, ns.
const GONE_NS: u64 = 2_000_000_000;
/// The floor is lower, and a table is higher than the first of these, m.
const FLOOR: f64 = 0.15;
/// An upright surface at least so wide and high is a wall, m.
const WALL: f64 = 1.2;
/// Surfaces of a shelf are at least so far apart, m; what is nearer above a table is something that stands on it.
const SHELF: f64 = 0.2;
/// Higher above a surface than this there may be another one that has nothing to do with it, m.
const STOREY: f64 = 0.8;

/// A surface of the environment.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceEstimate {
    /// Its name among all surfaces: its class, or that with a number.
    pub name: String,
    /// `table`, `shelf`, `floor`, `wall`, or `side` for an upright face of a thing.
    pub class: &'static str,
    /// Pose of the middle of its known part in the root frame; z is the outward normal, x along the longer edge.
    pub root_from_surface: Isometry3<f64>,
    /// Lengths of the known part along x and y, m.
    pub size: [f64; 2],
    /// Covariance of its height along z, m, and of its slopes along x and y, rad. It has the noise of depths and of where the camera
    /// was, and no error of the camera's mounting.
    pub covariance: Matrix3<f64>,
    /// The probability that it is there; 0 of one that is forgotten.
    pub probability: f64,
}

impl SurfaceEstimate {
    /// The class of this name, if surfaces have it.
    pub fn class_of(name: &str) -> Option<&'static str> {
        ["table", "shelf", "floor", "wall", "side"].into_iter().find(|class| *class == name)
    }
}

/// The environment as far as it was seen.
pub struct EnvironmentModel {
    camera: PinholeCamera,
    surfaces: Vec<Surface>,
    grid: Grid,
    last_ns: Option<u64>,
    /// What was told last of each surface, by its name, and when, ns.
    told: BTreeMap<String, (SurfaceEstimate, u64)>,
}

impl EnvironmentModel {
    /// A model for depth images of this camera, of which nothing is known.
    pub fn new(camera: PinholeCamera) -> Self {
        Self { camera, surfaces: Vec::new(), grid: Grid::default(), last_ns: None, told: BTreeMap::new() }
    }

    /// The same model with what is remembered from before. A surface whose numbers are not usable is left out.
    #[must_use]
    pub fn remembering(mut self, known: Vec<SurfaceEstimate>, bulks: Vec<BulkEstimate>) -> Self {
        self.grid = Grid::remembering(bulks);
        for surface in known.into_iter().take(MAX_SURFACES) {
            let SurfaceEstimate { root_from_surface: pose, size, covariance, probability, .. } = &surface;
            if let Some(mut one) = Surface::remembered(pose, *size, covariance, *probability) {
                one.name = Some((surface.class, surface.name));
                self.surfaces.push(one);
            }
        }
        self
    }

    /// Takes over what a frame shows, in which the robot's own body is where `own` says. Returns whether it had a depth image of the camera's
    /// size.
    pub fn update(&mut self, frame: &StereoFrame, own: &[OwnPart]) -> bool {
        let Some(depth) = frame.depth.as_ref().and_then(|depth| self.camera.usable(depth)) else {
            return false;
        };
        let dt = frame.stamp_ns.saturating_sub(self.last_ns.unwrap_or(frame.stamp_ns)) as f64 * 1e-9;
        self.last_ns = Some(frame.stamp_ns);
        let seen = DepthPoints::of(depth, &self.camera, &frame.root_from_left, SAMPLED);
        let mut owner = self.assigned(&seen);
        self.spread(&seen, &mut owner);
        for (i, surface) in self.surfaces.iter_mut().enumerate() {
            let of_it = seen.points.iter().zip(&owner).filter(|(_, owner)| **owner == Some(i));
            surface.measure(of_it.map(|(point, _)| point), dt);
        }
        let eye = Point3::from(frame.root_from_left.translation.vector);
        for _ in 0..MAX_NEW {
            if !self.find_new(&seen, &mut owner, &eye) {
                break;
            }
        }
        let view = View { camera: self.camera, depth, root_from_left: frame.root_from_left, seen, owner };
        for (i, surface) in self.surfaces.iter_mut().enumerate() {
            let normal = surface.normal();
            surface.look(|place| view.shows(place, i, &normal));
        }
        self.grid.look(&self.solid(&view.seen, own), |place| {
            match self.surfaces.iter().any(|of| of.is_near(place)) {
                true => Visibility::Through,
                false => view.behind(place, grid::EDGE),
            }
        });
        self.merge();
        self.surfaces.retain(|surface| surface.probability() >= FORGOTTEN);
        true
    }

    /// For each point, the surface that explains it.
    fn assigned(&self, seen: &DepthPoints) -> Vec<Option<usize>> {
        let of = |point: &DepthPoint| {
            let off = |i: &usize| self.surfaces[*i].above(&point.at).abs();
            let band = BAND * point.scale();
            let mut near = (0..self.surfaces.len()).filter(|i| off(i) < band);
            let mut of = near.by_ref().filter(|i| self.surfaces[*i].reaches(&point.at, GROWS));
            // Where two surfaces meet, a point says nothing of either: one would grow along the other.
            let first = of.next();
            if of.next().is_some() { Some(NOBODY) } else { first }
        };
        seen.points.iter().map(of).collect()
    }

    /// The points of something solid that no surface explains, nor the robot's own body, nor a thing that stands on furniture.
    fn solid(&self, seen: &DepthPoints, own: &[OwnPart]) -> Vec<Point3<f64>> {
        let is_furniture =
            |of: &Surface| of.normal().z > 0.5 && of.places().next().is_some_and(|at| at.z > FLOOR);
        let surfaces: Vec<_> = self.surfaces.iter().map(|of| (of, is_furniture(of))).collect();
        let explains = |point: &DepthPoint| {
            surfaces.iter().any(|(of, is_furniture)| {
                let (over, near) = (of.above(&point.at), MAY_BE_OF.0 * point.scale());
                let on_it = *is_furniture && (0.0..SHELF).contains(&over);
                (over.abs() < near || on_it) && of.reaches(&point.at, GROWS)
            })
        };
        let is_own = |point: &DepthPoint| own.iter().any(|part| part.distance(&point.at) < MAY_BE_OF.1);
        let near = seen.points.iter().filter(|point| f64::from(point.depth) < SOLID);
        near.filter(|point| !explains(point) && !is_own(point)).map(|point| point.at).collect()
    }

    /// What is solid and no surface, as boxes around it; one that is no longer there is told for two more seconds, with the probability 0.
    pub fn bulks(&mut self) -> Vec<BulkEstimate> {
        self.grid.bulks(self.last_ns.unwrap_or_default())
    }

    /// What a known surface reaches from point to point, beyond its cells, is its own, too. Else a part of a wall that comes into view at
    /// once would be taken for a surface of its own, and one across the corner for the best that fits two walls.
    fn spread(&self, seen: &DepthPoints, owner: &mut [Option<usize>]) {
        let mut open: Vec<usize> = (0..owner.len()).filter(|&i| owner[i].is_some()).collect();
        while let Some(here) = open.pop() {
            let of = owner[here];
            // What is nobody's goes on to nobody.
            let Some(surface) = of.and_then(|of| self.surfaces.get(of)) else { continue };
            for next in beside(seen, here) {
                let point = &seen.points[next];
                if owner[next].is_none() && surface.above(&point.at).abs() < BAND * point.scale() {
                    owner[next] = of;
                    open.push(next);
                }
            }
        }
    }

    /// Finds the largest surface among the points that none explains. Returns whether there may be more.
    fn find_new(&mut self, seen: &DepthPoints, owner: &mut [Option<usize>], eye: &Point3<f64>) -> bool {
        let wanted = |at: &Point3<f64>, normal: &Vector3<f64>| {
            upwards(normal).filter(|_| at.z < eye.z).or_else(|| towards(eye, at, normal))
        };
        let free = |i: usize| owner[i].is_none();
        if (0..owner.len()).filter(|&i| free(i)).count() < MIN_POINTS {
            return false;
        }
        let Some(plane) = Plane::largest(seen, &free, MIN_SHARE, &wanted) else { return false };
        if plane.deviation > FLAT {
            return false;
        }
        let in_it = |i: usize| {
            let point = &seen.points[i];
            free(i) && plane.above(&point.at).abs() < BAND * point.scale()
        };
        let part = connected(seen, &in_it);
        if part.len() < MIN_POINTS {
            return false;
        }
        let points = || part.iter().map(|&i| &seen.points[i]);
        let mut surface = Surface::new(&plane);
        surface.measure(points(), 0.0);
        let normal = surface.normal();
        let scale = points().map(DepthPoint::scale).fold(1.0, f64::max);
        let same = |known: &Surface| {
            let agrees =
                known.normal().angle(&normal) < SAME.1 && known.above(&plane.middle).abs() < SAME.0 * scale;
            agrees && points().step_by(7).any(|point| known.reaches(&point.at, SAME.2))
        };
        if let Some(known) = self.surfaces.iter_mut().find(|known| same(known)) {
            known.measure(points(), 0.0);
        } else {
            let least = if normal.z.abs() > 0.5 { MIN_AREA.0 } else { MIN_AREA.1 };
            let area = surface.places().count() as f64 * CELL * CELL;
            if self.surfaces.len() < MAX_SURFACES && area >= least {
                self.surfaces.push(surface);
            }
        }
        // Even where it is too small, it is not looked for again.
        part.iter().for_each(|&i| owner[i] = Some(NOBODY));
        true
    }

    /// What has come to be the same surface becomes one.
    fn merge(&mut self) {
        let mut i = 0;
        while i < self.surfaces.len() {
            let twin = (0..i).find(|&j| same_surface(&self.surfaces[i], &self.surfaces[j]));
            let Some(j) = twin else {
                i += 1;
                continue;
            };
            let (other, known) = (self.surfaces.remove(i), self.surfaces.remove(j));
            // The one that others know by name stays, or else the one that is known better.
            let better = known.name.is_some() && other.name.is_none()
                || known.name.is_some() == other.name.is_some() && known.certainty() >= other.certainty();
            let (mut stays, goes) = if better { (known, other) } else { (other, known) };
            stays.join(&goes);
            self.surfaces.insert(j, stays);
            i = j;
        }
    }

    /// What is known of each surface that is certain enough, or was before; one that is no longer there is told for two more seconds, with
    /// the probability 0.
    pub fn surfaces(&mut self) -> Vec<SurfaceEstimate> {
        let (now, now_ns) = (self.estimates(), self.last_ns.unwrap_or_default());
        for surface in now {
            self.told.insert(surface.name.clone(), (surface, now_ns));
        }
        self.told.retain(|_, (_, told_ns)| now_ns.saturating_sub(*told_ns) < GONE_NS);
        let told = self.told.values().map(|(surface, _)| match self.has(&surface.name) {
            true => surface.clone(),
            false => SurfaceEstimate { probability: 0.0, ..surface.clone() },
        });
        told.collect()
    }

    fn estimates(&mut self) -> Vec<SurfaceEstimate> {
        let rectangles: Vec<_> = self.surfaces.iter().map(Surface::rectangle).collect();
        let mut estimates: Vec<SurfaceEstimate> = Vec::new();
        for (i, rectangle) in rectangles.into_iter().enumerate() {
            let Some((pose, size)) = rectangle else { continue };
            let (probability, named) = (self.surfaces[i].probability(), self.surfaces[i].name.is_some());
            let Some(class) = self.class(i, &pose, size).filter(|_| named || probability >= TOLD) else {
                continue;
            };
            let Some(covariance) = self.surfaces[i].covariance(&pose) else { continue };
            let name = match &self.surfaces[i].name {
                Some((of, name)) if *of == class => name.clone(),
                _ => self.free_name(class),
            };
            self.surfaces[i].name = Some((class, name.clone()));
            let root_from_surface = pose;
            estimates.push(SurfaceEstimate { name, class, root_from_surface, size, covariance, probability });
        }
        estimates
    }

    /// Whether a surface has this name.
    fn has(&self, name: &str) -> bool {
        self.surfaces.iter().any(|surface| surface.name.as_ref().is_some_and(|(_, own)| own == name))
    }

    /// `class`, `class_2`, `class_3` ..., the first that no surface has now or had when it was told last.
    fn free_name(&self, class: &str) -> String {
        let free = |name: &String| !self.told.contains_key(name) && !self.has(name);
        let numbered = (2..=2 * MAX_SURFACES + 1).map(|n| format!("{class}_{n}"));
        std::iter::once(class.to_owned()).chain(numbered).find(free).unwrap_or_else(|| class.to_owned())
    }

    /// What kind of surface it is; `None` of one that is too low over another one for a piece of furniture: the top of a thing.
    fn class(&self, i: usize, pose: &Isometry3<f64>, size: [f64; 2]) -> Option<&'static str> {
        let normal = self.surfaces[i].normal();
        if normal.z < 0.5 {
            let wall = size[0] >= WALL && size[0] * size[1] >= WALL * WALL;
            return Some(if wall { "wall" } else { "side" });
        }
        let middle = Point3::from(pose.translation.vector);
        if middle.z < FLOOR {
            return Some("floor");
        }
        let others = self.surfaces.iter().enumerate().filter(|(j, other)| *j != i && other.normal().z > 0.5);
        let over = others.filter(|(_, other)| {
            let over = |from: &Surface, to: &Surface| from.share(|place| to.reaches(place, 0)) > 0.5;
            over(&self.surfaces[i], other) || over(other, &self.surfaces[i])
        });
        let mut class = "table";
        for (_, other) in over {
            let height = other.above(&middle);
            if (SAME.0..SHELF).contains(&height) {
                return None;
            }
            let floor = other.places().next().is_some_and(|place| place.z < FLOOR);
            if (SHELF..STOREY).contains(&height.abs()) && !floor {
                class = "shelf";
            }
        }
        Some(class)
    }
}

/// What a picture shows at places.
struct View<'f> {
    camera: PinholeCamera,
    depth: &'f DepthImage,
    root_from_left: Isometry3<f64>,
    seen: DepthPoints,
    /// For each of these points, the surface that explains it.
    owner: Vec<Option<usize>>,
}

impl View<'_> {
    /// A place in the left camera's frame, where it is in the picture, px, and the depth that is measured there, m.
    fn measured(&self, place: &Point3<f64>) -> Option<(Point3<f64>, Point2<f64>, f64)> {
        let in_left = self.root_from_left.inverse_transform_point(place);
        let px = self.camera.project(&in_left).filter(|px| px.x >= 0.0 && px.y >= 0.0)?;
        // No measurement is 0, as outside of the picture.
        let measured = f64::from(self.depth.at(px.x.round() as u32, px.y.round() as u32));
        (measured > 0.0 && measured.is_finite()).then_some((in_left, px, measured))
    }

    /// Whether something is measured more than `by` m behind a place.
    fn behind(&self, place: &Point3<f64>, by: f64) -> Visibility {
        match self.measured(place) {
            Some((in_left, _, measured)) if measured > in_left.z + by => Visibility::Through,
            _ => Visibility::Unknown,
        }
    }

    /// What is seen at a place of a surface with this normal, both in the root frame. What another surface explains says nothing for this one.
    fn shows(&self, place: &Point3<f64>, surface: usize, normal: &Vector3<f64>) -> Visibility {
        let Some((in_left, px, measured)) = self.measured(place) else { return Visibility::Unknown };
        let across = normal.dot(&(self.root_from_left.rotation * in_left.coords)).abs() / in_left.z;
        let behind = (measured - in_left.z) * across;
        let band = BAND * uncertainty(in_left.z);
        match behind {
            behind if behind.abs() < band => {
                let of = self.seen.nearest(&px).and_then(|point| self.owner[point]);
                if of.is_none_or(|of| of == surface) { Visibility::There } else { Visibility::Unknown }
            }
            behind if behind > band + BEHIND => Visibility::Through,
            _ => Visibility::Unknown,
        }
    }
}

/// The largest part of some points whose neighbours in the image are near each other.
fn connected(seen: &DepthPoints, is_in: &dyn Fn(usize) -> bool) -> Vec<usize> {
    let mut left: Vec<bool> = (0..seen.points.len()).map(is_in).collect();
    let mut largest = Vec::new();
    for start in 0..left.len() {
        if !std::mem::take(&mut left[start]) {
            continue;
        }
        let (mut part, mut open) = (vec![start], vec![start]);
        while let Some(here) = open.pop() {
            for next in beside(seen, here) {
                if std::mem::take(&mut left[next]) {
                    part.push(next);
                    open.push(next);
                }
            }
        }
        if part.len() > largest.len() {
            largest = part;
        }
    }
    largest
}

/// The neighbours of a point in the image that are near it.
fn beside(seen: &DepthPoints, here: usize) -> impl Iterator<Item = usize> {
    let DepthPoint { place, at, .. } = &seen.points[here];
    let steps = [(1, 0), (-1, 0), (0, 1), (0, -1), (2, 0), (-2, 0), (0, 2), (0, -2)];
    let there = steps.into_iter().filter_map(|step| seen.beside(*place, step));
    there.filter(move |&next| (seen.points[next].at - at).norm() < CONNECTED)
}

/// Whether two surfaces are one: their planes agree, and a part of one lies on the other or beside it. Of the floor there is only one, also
/// where what stands on it hides what is between.
fn same_surface(a: &Surface, b: &Surface) -> bool {
    if a.normal().angle(&b.normal()) > SAME.1 {
        return false;
    }
    let floor = [a, b].iter().all(|s| s.normal().z > 0.5 && s.places().next().is_some_and(|at| at.z < FLOOR));
    let lies_on = |of: &Surface, on: &Surface| {
        of.share(|at| on.above(at).abs() < 2.0 * SAME.0 && (floor || on.reaches(at, SAME.2))) > 0.1
    };
    lies_on(a, b) || lies_on(b, a)
}

#[cfg(test)]
mod tests;

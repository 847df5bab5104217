//! The probe `environment`: what the robot's memory knows of the surfaces and bulks around it, against where they are, and how long it took
//! to notice that a surface had moved away.

use armarium_values::distance_from_box;
use armarium_values::report::Requirement::{AtMost, Shown};
use armarium_values::report::{Block, Cell, Figure, Path, PathStyle, Plan, Requirement, Section};
use armarium_visionx::{BulkEstimate, PinholeCamera};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use serde::Serialize;
use serde_json::Value;

use super::imitation::plan;
use super::log::KnownSurface;
use super::probes::{Probe, cell, figure, table_of, things};
use super::run::JudgedRun;
use crate::render::Background;
use crate::table::{LEG_RADIUS, TableTop};
use crate::truth::FrameTruth;
use crate::world::{BodyShape, World};

pub(super) const PROBE: Probe = Probe { name: "environment", measure, asks, section };

/// A face whose edges are shorter is no piece of furniture, m.
const FURNITURE: f64 = 0.3;
/// A known surface is of a true one if it is so near, m, and their normals differ by so little, rad.
const NEAR: (f64, f64) = (0.10, 0.2);
/// What is less probable is not taken for there.
const THERE: f64 = 0.5;
/// A surface that was looked at for so long is to be known, s.
const LOOKED: f64 = 2.0;
/// A body that has moved by more than this, m, has left its place.
const LEFT: f64 = 0.05;
/// What is asked: of height, m, and tilt, degrees, with a camera without errors and with one that errs; of fading, s.
const EXACT: (f64, f64) = (0.003, 0.5);
const PLAUSIBLE: (f64, f64) = (0.008, 0.7);
const FADES: f64 = 3.0;
/// Nearer and farther than this depth is not measured well, m.
const RANGE: (f64, f64) = (0.4, 3.0);

/// A true face.
struct Face {
    name: String,
    /// Its middle; z is its outward normal.
    pose: Isometry3<f64>,
    half: [f64; 2],
    /// Whether it is the top of a piece of furniture.
    is_top: bool,
    /// Whether it is the table's, where the robot works.
    is_table: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct EnvironmentFigures {
    /// The tops of furniture, in the order of the world.
    tops: Vec<TopFigures>,
    /// How many known surfaces are of a true one of which another is, too.
    twice: usize,
    /// How many known surfaces are where there is none.
    invented: usize,
    /// Surfaces that are known at the end.
    known: usize,
    /// What is there and has no flat faces.
    bulks: Vec<BulkFigures>,
    /// How many known bulks are where there is nothing.
    bulk_invented: usize,
    moved: Vec<MovedFigures>,
    /// What is asked of heights, m, and tilts, degrees.
    height_within_m: f64,
    tilt_within_deg: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct TopFigures {
    name: String,
    /// Whether its height and its tilt are judged: those of the table, where the robot works.
    judged: bool,
    /// For how long its middle was in view, s.
    looked_at_s: f64,
    /// What it is known as.
    #[serde(skip_serializing_if = "Option::is_none")]
    known_as: Option<String>,
    /// 1 where it was looked at and is not known.
    missed: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    height_error_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    tilt_error_deg: Option<f64>,
    /// Its longer and its shorter edge as known, less the true ones, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    size_error_m: Option<[f64; 2]>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct BulkFigures {
    name: String,
    /// For how long its middle was in view, s.
    looked_at_s: f64,
    /// 1 where it was looked at and no known bulk is near its middle.
    missed: u32,
    /// The longest edge of the nearest known one less its own diameter, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    size_error_m: Option<f64>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct MovedFigures {
    name: String,
    /// For how long its old place was in view until it was no longer known there, s; `None` if it still is.
    #[serde(skip_serializing_if = "Option::is_none")]
    faded_after_s: Option<f64>,
    /// 1 where it still is, though it was looked at for so long as it takes.
    still_known: u32,
}

fn measure(run: &JudgedRun<'_>) -> Option<Value> {
    // Without a model of the surroundings there is nothing to judge.
    run.log.surfaces.iter().find(|(_, _, known)| known.is_some())?;
    let (bulk, known): (Vec<_>, Vec<_>) =
        known_at(run, u64::MAX).into_iter().partition(|known| known.class == BulkEstimate::CLASS);
    let faces = faces(run, |begin_and_end| begin_and_end.1);
    let (mut of_face, mut invented) = (vec![Vec::new(); faces.len()], 0);
    for surface in &known {
        match faces.iter().position(|face| face.is(surface)) {
            Some(face) => of_face[face].push(*surface),
            None => invented += 1,
        }
    }
    let twice = of_face.iter().map(|of| of.len().saturating_sub(1)).sum();
    let (height_within_m, tilt_within_deg) = asked(run.world);
    let tops = faces.iter().zip(&of_face).filter(|(face, _)| face.is_top);
    let tops = tops.map(|(face, of)| top(run, face, of.first().copied())).collect();
    let (known, moved, (bulks, bulk_invented)) = (known.len(), moved(run), bulks(run, &bulk, &faces));
    let figures = EnvironmentFigures {
        tops,
        twice,
        invented,
        known,
        bulks,
        bulk_invented,
        moved,
        height_within_m,
        tilt_within_deg,
    };
    serde_json::to_value(figures).ok()
}

/// What is asked of heights, m, and tilts, degrees.
fn asked(world: &World) -> (f64, f64) {
    let mounting = &world.camera.mounting_error;
    let joints = &world.physics.0;
    let off = [mounting.distance, mounting.angle_deg, joints.joint_zero_deg, joints.backlash_deg];
    let exact = off.iter().chain(&mounting.position).chain(&mounting.rotation_deg).all(|v| *v == 0.0);
    if exact { EXACT } else { PLAUSIBLE }
}

/// What memory held at a time and took for there.
fn known_at<'r>(run: &JudgedRun<'r>, at_ns: u64) -> Vec<&'r KnownSurface> {
    let mut held = std::collections::BTreeMap::new();
    for (_, name, known) in run.log.surfaces.iter().take_while(|(stamp, ..)| *stamp <= at_ns) {
        held.insert(name, known.as_ref());
    }
    held.into_values().flatten().filter(|surface| surface.probability >= THERE).collect()
}

/// All faces that can be seen; `pick` says where a body counts, of where it began and where it ended.
fn faces(
    run: &JudgedRun<'_>,
    pick: impl Fn((Isometry3<f64>, Isometry3<f64>)) -> Isometry3<f64>,
) -> Vec<Face> {
    let table = TableTop::new(&run.world.table);
    let mut faces = vec![Face {
        name: "table".into(),
        pose: *table.root_from_top(),
        half: table.half(),
        is_top: true,
        is_table: true,
    }];
    let objects = run.world.objects.len();
    for (index, body) in (objects..).zip(&run.world.bodies).filter(|(_, body)| body.shape == BodyShape::Box) {
        let Some(pose) = run.log.begin_and_end(index).map(&pick) else { continue };
        faces.extend(faces_of(&body.name, &pose, &body.half()));
    }
    let room = Background::default();
    let (middle, half) = ((room.lower + room.upper) / 2.0, (room.upper - room.lower) / 2.0);
    // A room is seen from inside.
    let inside = faces_of("room", &Isometry3::from_parts(middle.into(), UnitQuaternion::identity()), &-half);
    faces.extend(inside.into_iter().map(|f| Face { half: f.half.map(f64::abs), is_top: false, ..f }));
    faces
}

/// The six faces of a box.
fn faces_of(name: &str, pose: &Isometry3<f64>, half: &Vector3<f64>) -> Vec<Face> {
    let face = |(axis, sign): (usize, f64)| {
        let mut normal = Vector3::zeros();
        normal[axis] = sign;
        let other = Vector3::from_fn(|i, _| f64::from(u8::from(i == (axis + 1) % 3)));
        let axes = nalgebra::Matrix3::from_columns(&[other, normal.cross(&other), normal]);
        let turn = UnitQuaternion::from_matrix(&axes);
        let at = normal * half[axis];
        let outward = pose * Isometry3::from_parts(at.into(), turn);
        let edges = [half[(axis + 1) % 3], half[(axis + 2) % 3]];
        let up = (outward * Vector3::z()).z > 0.9;
        let is_top = up && edges.iter().all(|edge| 2.0 * edge >= FURNITURE);
        Face { name: name.to_owned(), pose: outward, half: edges, is_top, is_table: false }
    };
    [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0), (2, -1.0)].map(face).into()
}

impl Face {
    fn normal(&self) -> Vector3<f64> {
        self.pose * Vector3::z()
    }

    /// Whether a known surface is of this face.
    fn is(&self, surface: &KnownSurface) -> bool {
        let middle = self.pose.inverse() * Point3::from(surface.root_from_surface.translation.vector);
        let normal = surface.root_from_surface * Vector3::z();
        middle.z.abs() < NEAR.0
            && self.normal().angle(&normal) < NEAR.1
            && (0..2).all(|i| middle[i].abs() <= self.half[i] + NEAR.0)
    }
}

fn top(run: &JudgedRun<'_>, face: &Face, known: Option<&KnownSurface>) -> TopFigures {
    let looked_at_s =
        looked_at(run, &[face.pose.translation.vector.into()], 0).last().map_or(0.0, |(_, s)| *s);
    let edges = |[x, y]: [f64; 2]| [x.max(y), x.min(y)];
    let height = |known: &KnownSurface| {
        let middle = Point3::from(known.root_from_surface.translation.vector);
        (face.pose.inverse() * middle).z
    };
    let size = |known: &KnownSurface| {
        let (is, should) = (edges([known.size[0], known.size[1]]), edges(face.half.map(|half| 2.0 * half)));
        [is[0] - should[0], is[1] - should[1]]
    };
    let tilt =
        |known: &KnownSurface| face.normal().angle(&(known.root_from_surface * Vector3::z())).to_degrees();
    TopFigures {
        name: face.name.clone(),
        judged: face.is_table,
        looked_at_s,
        known_as: known.map(|known| known.class.clone()),
        missed: u32::from(known.is_none() && looked_at_s > LOOKED),
        height_error_m: known.map(height),
        tilt_error_deg: known.map(tilt),
        size_error_m: known.map(size),
    }
}

/// The balls that are as large as furniture, and how many of the known bulks are near to nothing.
fn bulks(run: &JudgedRun<'_>, known: &[&KnownSurface], faces: &[Face]) -> (Vec<BulkFigures>, usize) {
    let objects = run.world.objects.len();
    let balls = (objects..).zip(&run.world.bodies).filter(|(_, body)| body.shape == BodyShape::Sphere);
    let large = balls.filter(|(_, body)| body.diameter >= FURNITURE);
    let mut near_something = vec![false; known.len()];
    let mut figures = Vec::new();
    for (index, body) in large {
        let Some((_, pose)) = run.log.begin_and_end(index) else { continue };
        let middle = Point3::from(pose.translation.vector);
        let apart = |bulk: &KnownSurface| {
            distance_from_box(&middle, &bulk.root_from_surface, &Vector3::from(bulk.size))
        };
        let of_it = |bulk: &KnownSurface| apart(bulk) < body.diameter / 2.0;
        near_something.iter_mut().zip(known).for_each(|(near, bulk)| *near |= of_it(bulk));
        let nearest = known.iter().filter(|bulk| of_it(bulk)).min_by(|a, b| apart(a).total_cmp(&apart(b)));
        let looked_at_s = looked_at(run, &[middle], 0).last().map_or(0.0, |(_, s)| *s);
        figures.push(BulkFigures {
            name: body.name.clone(),
            looked_at_s,
            missed: u32::from(nearest.is_none() && looked_at_s > LOOKED),
            size_error_m: nearest.map(|bulk| bulk.size.into_iter().fold(0.0, f64::max) - body.diameter),
        });
    }
    // What is seen of a body before its faces are known is of that body; legs of a table have none.
    let flat = faces.iter().map(|face| (face.pose, Vector3::new(face.half[0], face.half[1], 0.0) * 2.0));
    let leg = |(pose, half)| (pose, Vector3::new(LEG_RADIUS, LEG_RADIUS, half) * 2.0);
    let legs = TableTop::new(&run.world.table).legs().map(leg);
    let solid: Vec<_> = flat.chain(legs).collect();
    let at_something = |bulk: &KnownSurface| {
        let middle = Point3::from(bulk.root_from_surface.translation.vector);
        solid.iter().any(|(pose, size)| distance_from_box(&middle, pose, size) < 2.0 * NEAR.0)
    };
    let invented =
        near_something.iter().zip(known).filter(|(near, bulk)| !**near && !at_something(bulk)).count();
    (figures, invented)
}

/// The frames from a time on in which one of some places is in view, with the time for which that has been so by then, s.
fn looked_at(run: &JudgedRun<'_>, places: &[Point3<f64>], from_ns: u64) -> Vec<(u64, f64)> {
    let spec = &run.world.camera;
    let center = [f64::from(spec.width) / 2.0, f64::from(spec.height) / 2.0];
    let camera = PinholeCamera { width: spec.width, height: spec.height, focal: spec.focal, center };
    let within = |v: f64, size: u32| v > 0.0 && v < f64::from(size) - 1.0;
    let in_view = |frame: &FrameTruth, place: &Point3<f64>| {
        let in_left = frame.root_from_left.inverse() * place;
        let px = camera.project(&in_left).filter(|_| (RANGE.0..RANGE.1).contains(&in_left.z));
        px.is_some_and(|px| within(px.x, camera.width) && within(px.y, camera.height))
    };
    let frames = run.log.frames.iter().filter(|frame| frame.stamp_ns >= from_ns);
    let seen = frames.filter(|frame| places.iter().any(|place| in_view(frame, place)));
    seen.zip(1..).map(|(frame, n)| (frame.stamp_ns, f64::from(n) / spec.rate)).collect()
}

/// The furniture that has left its place.
fn moved(run: &JudgedRun<'_>) -> Vec<MovedFigures> {
    let tops = faces(run, |begin_and_end| begin_and_end.0);
    let mut figures = Vec::new();
    for top in tops.iter().filter(|top| top.is_top) {
        let bodies = || run.world.named_bodies().enumerate();
        let Some((index, spec)) = bodies().find(|(_, body)| body.name == top.name) else { continue };
        let Some((begin, end)) = run.log.begin_and_end(index) else { continue };
        let way = (begin.inverse() * end).translation.vector;
        let half = spec.half();
        // Only where it does not cover the middle of its old place any more.
        if (0..2).all(|i| way[i].abs() < half[i] + LEFT) {
            continue;
        }
        let left = |pose: &Isometry3<f64>| {
            let way = (begin.inverse() * pose).translation.vector;
            (0..2).any(|i| way[i].abs() >= half[i] + LEFT)
        };
        let moves = run.log.moved.get(&index).map_or(&[][..], Vec::as_slice);
        let Some((left_ns, _)) = moves.iter().find(|(_, pose)| left(pose)) else { continue };
        let known = |stamp: u64| {
            known_at(run, stamp)
                .iter()
                .any(|surface| surface.class != BulkEstimate::CLASS && covers(surface, top))
        };
        // What was not known before cannot fade.
        if !known(*left_ns) {
            continue;
        }
        let corner = |x: f64, y: f64| top.pose * Point3::new(x * top.half[0], y * top.half[1], 0.0);
        let signs = [(0.0, 0.0), (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
        let places = signs.map(|(x, y)| corner(x, y));
        let looked = looked_at(run, &places, *left_ns);
        let faded = looked.iter().find(|(stamp, _)| !known(*stamp));
        let looked_for_s = looked.last().map_or(0.0, |(_, s)| *s);
        let still_known = u32::from(faded.is_none() && looked_for_s > FADES);
        let (name, faded_after_s) = (top.name.clone(), faded.map(|(_, s)| *s));
        figures.push(MovedFigures { name, faded_after_s, still_known });
    }
    figures
}

/// Whether a known surface covers the middle of a face.
fn covers(surface: &KnownSurface, face: &Face) -> bool {
    let middle = surface.root_from_surface.inverse() * Point3::from(face.pose.translation.vector);
    middle.z.abs() < NEAR.0 && (0..2).all(|i| middle[i].abs() <= surface.size[i] / 2.0)
}

fn asks(own: &Value) -> Vec<Figure> {
    let number = |key: &str| own.get(key).and_then(Value::as_f64).unwrap_or_default();
    let of = |name, of: &Value, key, unit, requirement: Requirement| {
        figure(("Surroundings", name), of, key, unit, requirement)
    };
    let mut figures = vec![
        of("surfaces known", own, ("known", 1.0), ("", 0), Shown),
        of("known twice", own, ("twice", 1.0), ("", 0), AtMost(0.0)),
        of("known where there is none", own, ("invented", 1.0), ("", 0), AtMost(0.0)),
        of("bulks where there is nothing", own, ("bulk_invented", 1.0), ("", 0), AtMost(0.0)),
    ];
    for top in things(&own["tops"]) {
        let group = format!("Top of {}", top["name"].as_str().unwrap_or_default());
        let mut ask = |name, value: &Value, key, unit, requirement| {
            figures.push(figure((&group, name), value, key, unit, requirement));
        };
        ask("missed", top, ("missed", 1.0), ("", 0), AtMost(0.0));
        let Some(height) = top.get("height_error_m").and_then(Value::as_f64) else { continue };
        let off = serde_json::json!({"height": height.abs()});
        let within = |key, factor| if top["judged"] == true { AtMost(number(key) * factor) } else { Shown };
        ask("height off by", &off, ("height", 1e3), ("mm", 1), within("height_within_m", 1e3));
        ask("tilt off by", top, ("tilt_error_deg", 1.0), ("°", 2), within("tilt_within_deg", 1.0));
    }
    for bulk in things(&own["bulks"]) {
        let group = format!("Bulk of {}", bulk["name"].as_str().unwrap_or_default());
        let mut ask = |name, key, unit, requirement| {
            figures.push(figure((&group, name), bulk, key, unit, requirement));
        };
        ask("missed", ("missed", 1.0), ("", 0), AtMost(0.0));
        ask("longest edge off by", ("size_error_m", 1e3), ("mm", 0), Shown);
    }
    for moved in things(&own["moved"]) {
        let group = format!("Place that {} left", moved["name"].as_str().unwrap_or_default());
        let mut ask = |name, key, unit, requirement| {
            figures.push(figure((&group, name), moved, (key, 1.0), (unit, 1), requirement));
        };
        ask("faded after being looked at for", "faded_after_s", "s", AtMost(FADES));
        ask("still known", "still_known", "", AtMost(0.0));
    }
    figures
}

/// What memory knows at the end, seen from above, and what is there.
fn from_above(run: &JudgedRun<'_>) -> Plan {
    let outline = |pose: &Isometry3<f64>, half: [f64; 2]| {
        let corner = |(x, y)| pose * Point3::new(x * half[0], y * half[1], 0.0);
        let corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].map(corner);
        corners.map(|at| [at.x, at.y]).to_vec()
    };
    let faces = faces(run, |begin_and_end| begin_and_end.1);
    let there = faces.iter().filter(|face| face.normal().z > 0.9).map(|face| Path {
        label: "what is there".into(),
        style: PathStyle::Outline,
        points: outline(&face.pose, face.half),
    });
    let known = known_at(run, u64::MAX).into_iter().map(|known| Path {
        label: format!("known as {}", known.class),
        style: PathStyle::Line,
        points: outline(&known.root_from_surface, [known.size[0] / 2.0, known.size[1] / 2.0]),
    });
    plan("What memory knows at the end, from above", there.chain(known).collect())
}

fn section(run: &JudgedRun<'_>, own: &Value) -> Vec<Section> {
    let titles = ["Top of", "Known as", "#Looked at for", "#Height off by", "#Tilt off by"];
    let tops = table_of(&own["tops"], &titles, |top| {
        let text = |key: &str| Cell::Text(top[key].as_str().unwrap_or("-").to_owned());
        vec![
            text("name"),
            text("known_as"),
            cell(top, ("looked_at_s", 1.0), "s", 1),
            cell(top, ("height_error_m", 1e3), "mm", 1),
            cell(top, ("tilt_error_deg", 1.0), "°", 2),
        ]
    });
    let note = "What memory knows at the end of the tops of furniture, against where they are; `looked at` counts the time in which the middle was in view.";
    if own.is_null() {
        return Vec::new();
    }
    vec![Section::new("Surroundings", note, vec![Block::Plan(from_above(run)), Block::Table(tops)])]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_faces_of_a_box_look_outwards_and_those_of_a_room_inwards() {
        let half = Vector3::new(0.3, 0.2, 0.4);
        let faces = faces_of("box", &Isometry3::translation(1.0, 2.0, 0.4), &half);
        for face in &faces {
            let out = face.pose.translation.vector - Vector3::new(1.0, 2.0, 0.4);
            assert!((out.normalize() - face.normal()).norm() < 1e-9);
            let across: Vec<f64> =
                (0..2).map(|i| (face.pose * Vector3::ith(i, face.half[i])).abs().max()).collect();
            let edges: Vec<f64> = (0..3).filter(|i| face.normal()[*i].abs() < 0.5).map(|i| half[i]).collect();
            assert!(
                across.iter().all(|a| edges.iter().any(|e| (a - e).abs() < 1e-9)),
                "{across:?} {edges:?}"
            );
        }
        assert_eq!(faces.iter().filter(|face| face.is_top).count(), 1);
        let inside = faces_of("room", &Isometry3::identity(), &-half);
        assert!(inside.iter().all(|face| face.pose.translation.vector.dot(&face.normal()) < 0.0));
    }
}

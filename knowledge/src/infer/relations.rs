//! Spatial relations: which object is on, in, near or left of another, computed from their positions and sizes.
//!
//! Each relation is a few conditions on differences of coordinates. Positions are normally distributed, so each
//! condition has a probability. The product of these, times the lower confidence of the two objects, is the
//! relation's confidence. Relations below one half are not written. Objects are boxes along the axes of their frame,
//! which is the robot's root (x to its right, y forward, z up) or a frame like it. Objects in different frames are
//! not compared.

use std::collections::BTreeMap;
use std::time::Duration;

use armarium_memoryx::{Memory, MemoryError, Pattern, Snapshot};
use armarium_values::Value;
use async_trait::async_trait;

use super::solid::{SolidObject, between};
use super::{Conclusion, Inference, joined};
use crate::prior::OBJECT_CLASSES;
use crate::updater::OBJECT_INSTANCES;

/// The core segment of relations.
pub const OBJECT_RELATIONS: &str = "ObjectRelations";
/// The core segment of tables, walls and other fixed objects.
const ENVIRONMENT: &str = "EnvironmentModels";
const X: usize = 0;
const Y: usize = 1;
const Z: usize = 2;

/// Largest gap between an object and its support, m.
const TOUCHING: f64 = 0.02;
/// Largest gap between objects that are near each other, m.
const NEAR: f64 = 0.15;
/// Largest gap for "left of", m.
const BESIDE: f64 = 0.5;
/// Lowest confidence that is written.
const LEAST: f64 = 0.5;

/// Concludes `ObjectRelations` from `ObjectInstances` and `EnvironmentModels`.
#[derive(Clone, Debug)]
pub struct SpatialRelations;

/// All relations among the objects. Only boxes within reach of each other along x are compared.
fn relations(mut solids: Vec<SolidObject>) -> Vec<Conclusion> {
    solids.sort_by(|a, b| a.min(X).total_cmp(&b.min(X)).then_with(|| a.id.cmp(&b.id)));
    let unsure = 6.0 * solids.iter().map(|s| s.variance[X]).fold(0.0, f64::max).sqrt();
    let reach = BESIDE.max(NEAR) + 2.0 * unsure;
    let mut found = Vec::new();
    for (i, a) in solids.iter().enumerate() {
        for b in solids[i + 1..].iter().take_while(|b| b.min(X) <= a.max(X) + reach) {
            // The same object from two providers has no relation to itself.
            if a.frame == b.frame && (a.class != b.class || a.id.entity() != b.id.entity()) {
                found.extend(of_two(a, b));
            }
        }
    }
    found
}

/// The relations of two objects. "Near" is written once per pair, and not where one is in or on the other.
fn of_two(a: &SolidObject, b: &SolidObject) -> Vec<Conclusion> {
    let mut found = Vec::new();
    for (a, b) in [(a, b), (b, a)] {
        let inside = probability_in(a, b);
        found.extend(conclusion(a, b, "in", inside));
        found.extend(conclusion(a, b, "on", (1.0 - inside) * probability_on(a, b)));
    }
    if found.is_empty() {
        let (first, second) = if a.id < b.id { (a, b) } else { (b, a) };
        found.extend(conclusion(first, second, "near", probability_near(a, b)));
    }
    found.extend(conclusion(a, b, "left_of", probability_left(a, b)));
    found.extend(conclusion(b, a, "left_of", probability_left(b, a)));
    found
}

/// The underside of `a` is at the top of `b`, and the centre of `a` is above `b`.
fn probability_on(a: &SolidObject, b: &SolidObject) -> f64 {
    if a.half.is_none() || b.half.is_none() {
        return 0.0;
    }
    let gap = between(a.min(Z) - b.max(Z), a.sigma(b, Z), -TOUCHING, TOUCHING);
    gap * over(a, b, X) * over(a, b, Y)
}

/// The gap between the two is small along every axis.
fn probability_near(a: &SolidObject, b: &SolidObject) -> f64 {
    (0..3)
        .map(|axis| {
            let reach = NEAR + halves(a, b, axis);
            between(a.centre[axis] - b.centre[axis], a.sigma(b, axis), -reach, reach)
        })
        .product()
}

/// All of `a` is left of all of `b`, within reach, and not behind, before or above it.
fn probability_left(a: &SolidObject, b: &SolidObject) -> f64 {
    let gap = between(b.min(X) - a.max(X), a.sigma(b, X), 0.0, BESIDE);
    let beside = |axis: usize| {
        let reach = halves(a, b, axis).max(TOUCHING);
        between(a.centre[axis] - b.centre[axis], a.sigma(b, axis), -reach, reach)
    };
    gap * beside(Y) * beside(Z)
}

/// The relation of `a` to `b`, if its confidence is high enough.
fn conclusion(a: &SolidObject, b: &SolidObject, relation: &str, probability: f64) -> Option<Conclusion> {
    let confidence = (probability * a.confidence.min(b.confidence)).clamp(0.0, 1.0);
    if confidence < LEAST {
        return None;
    }
    let name = |s: &SolidObject| joined(&[s.id.provider(), s.id.entity()]);
    let attributes = [
        ("subject".to_owned(), Value::from(a.id.as_str())),
        ("relation".to_owned(), relation.into()),
        ("object".to_owned(), b.id.as_str().into()),
    ];
    Some(Conclusion {
        segment: OBJECT_RELATIONS.into(),
        entity: joined(&[&name(a), relation, &name(b)]),
        attributes: attributes.into(),
        covariance: BTreeMap::new(),
        confidence,
        referenced_ns: a.referenced_ns.max(b.referenced_ns),
        because: vec![(a.id.clone(), a.version), (b.id.clone(), b.version)],
    })
}

/// The centre of `a` is within the extent of `b` along an axis.
fn over(a: &SolidObject, b: &SolidObject, axis: usize) -> f64 {
    between(a.centre[axis], a.sigma(b, axis), b.min(axis), b.max(axis))
}

/// Half the sum of both extents.
fn halves(a: &SolidObject, b: &SolidObject, axis: usize) -> f64 {
    a.half.map_or(0.0, |half| half[axis]) + b.half.map_or(0.0, |half| half[axis])
}

/// The centre of `a` is inside `b`, and `a` is smaller.
fn probability_in(a: &SolidObject, b: &SolidObject) -> f64 {
    if a.half.is_none() || b.half.is_none() || a.volume() >= b.volume() {
        return 0.0;
    }
    (0..3).map(|axis| over(a, b, axis)).product()
}

/// The extent in the snapshot, or else that of its class.
fn size_of(snapshot: &Snapshot, classes: &BTreeMap<String, [f64; 3]>) -> Option<[f64; 3]> {
    let own = snapshot.attribute("size").and_then(Value::as_vector3);
    let size = own.or_else(|| classes.get(snapshot.attribute("class")?.as_str()?).copied());
    size.filter(|size| size.iter().all(|x| x.is_finite()))
}

#[async_trait]
impl Inference for SpatialRelations {
    fn name(&self) -> &str {
        "spatial_relations"
    }

    fn watches(&self) -> Vec<Pattern> {
        [OBJECT_INSTANCES, ENVIRONMENT, OBJECT_CLASSES].map(Pattern::segment).into()
    }

    fn pause(&self) -> Duration {
        Duration::from_millis(200)
    }

    async fn conclude(&self, memory: &dyn Memory, _now_ns: u64) -> Result<Vec<Conclusion>, MemoryError> {
        let classes = memory.segment(OBJECT_CLASSES).await?;
        let size = |s: &Snapshot| s.attribute("size").and_then(Value::as_vector3);
        let classes: BTreeMap<String, [f64; 3]> =
            classes.iter().filter_map(|s| Some((s.id.entity().to_owned(), size(s)?))).collect();
        let mut solids = Vec::new();
        for segment in [OBJECT_INSTANCES, ENVIRONMENT] {
            let held = memory.segment(segment).await?;
            solids.extend(held.iter().filter_map(|s| SolidObject::new(s, size_of(s, &classes))));
        }
        Ok(relations(solids))
    }
}

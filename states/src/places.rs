//! What memory knows of where things and places are, as boxes in the root frame. It moves nothing and plans nothing.

use std::sync::Arc;

use armarium_memoryx::{EntityId, Memory, Pattern, Query, Snapshot};
use armarium_robot::planning::KnownBox;
use armarium_runtime::skill::Failure;
use nalgebra::{Point3, Translation3, Vector3};

use crate::inputs::as_pose;
use crate::motions::failed;
use crate::prior::{class_name, object_class};

/// A place without thickness is a surface that was seen from above; it is taken for this thick, m.
const THICKNESS: f64 = 0.02;
/// A place that is nearer than this to where a hand grasps is what it works on, m.
const WORKED_ON: f64 = 0.1;

/// What memory knows of where something is.
pub(crate) struct Known {
    pub(crate) shape: KnownBox,
    /// Its address, if it is a thing that a hand can take.
    pub(crate) thing: Option<EntityId>,
}

/// The names of the places near to one of these points (root frame, m).
pub(crate) async fn places_at(memory: &dyn Memory, points: &[Point3<f64>]) -> Result<Vec<String>, Failure> {
    let near = |place: &KnownBox| points.iter().any(|point| distance(place, point) < WORKED_ON);
    Ok(places(memory).await?.into_iter().filter(near).map(|place| place.name).collect())
}

/// What memory holds now of places and things, each with its extent. Things in a hand and what has no pose in the root frame are
/// left out, and so are things whose class nobody knows.
pub(crate) async fn known(memory: &dyn Memory) -> Result<Vec<Known>, Failure> {
    let mut all: Vec<Known> =
        places(memory).await?.into_iter().map(|shape| Known { shape, thing: None }).collect();
    for thing in segment(memory, "ObjectInstances").await? {
        if thing.attribute("attached_to").is_some() {
            continue;
        }
        let Ok(class) = class_name(&thing) else { continue };
        let Ok(class) = object_class(memory, class).await else { continue };
        all.extend(shape(&thing, class.size).map(|shape| Known { shape, thing: Some(thing.id.clone()) }));
    }
    Ok(all)
}

/// What memory holds now of places: tables, walls. What has no pose in the root frame or no extent is left out.
pub(crate) async fn places(memory: &dyn Memory) -> Result<Vec<KnownBox>, Failure> {
    let known = segment(memory, "EnvironmentModels").await?;
    let place = |place: &Arc<Snapshot>| {
        let mut size = place.attribute("size").and_then(armarium_values::Value::as_vector3)?;
        let is_surface = size[2] == 0.0;
        if is_surface {
            size[2] = THICKNESS;
        }
        let mut shape = shape(place, size)?;
        if is_surface {
            shape.root_from_box *= Translation3::new(0.0, 0.0, -THICKNESS / 2.0);
        }
        Some(shape)
    };
    Ok(known.iter().filter_map(place).collect())
}

async fn segment(memory: &dyn Memory, name: &str) -> Result<Vec<Arc<Snapshot>>, Failure> {
    memory.query(&Query::latest(Pattern::segment(name))).await.map_err(failed)
}

fn shape(snapshot: &Snapshot, size: [f64; 3]) -> Option<KnownBox> {
    let root_from_box = snapshot.attribute("pose").and_then(as_pose)?;
    let size = Vector3::from(size);
    let is_box = size.iter().all(|edge| edge.is_finite() && *edge > 0.0);
    let placed = root_from_box.translation.vector.iter().all(|x| x.is_finite());
    (is_box && placed).then(|| KnownBox { name: snapshot.id.entity().to_owned(), root_from_box, size })
}

/// The distance of a point from a box, m; 0 inside.
pub(crate) fn distance(known: &KnownBox, point: &Point3<f64>) -> f64 {
    let in_box = known.root_from_box.inverse() * point;
    (in_box.coords.abs() - known.size / 2.0).sup(&Vector3::zeros()).norm()
}

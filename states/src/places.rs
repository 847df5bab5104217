//! What memory knows of where things and places are, as boxes in the root frame. It moves nothing and plans nothing.

use std::sync::Arc;

use armarium_knowledge::{ObjectClass, WORLD};
use armarium_memoryx::{EntityId, Memory, Snapshot};
use armarium_robot::planning::KnownBox;
use armarium_runtime::skill::Failure;
use armarium_values::transforms::Transforms;
use armarium_values::{Frame, Observation, Search, Value, distance_from_box};
use armarium_visionx::BulkEstimate;
use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use parking_lot::RwLock;

use crate::inputs::as_pose;
use crate::motions::failed;
use crate::prior::class_of;

/// A place without thickness is a surface that was seen from above; it is taken for this thick, m.
const THICKNESS: f64 = 0.02;
/// A place that is nearer than this to where a hand grasps is what it works on, m.
const WORKED_ON: f64 = 0.1;

/// The core segment of places.
pub(crate) const PLACES: &str = "EnvironmentModels";

/// The time of what always holds, ns.
const NOW: u64 = 0;

/// Memory, with the frames in which its poses may be.
#[derive(Clone, Copy)]
pub(crate) struct Remembered<'a> {
    pub(crate) memory: &'a dyn Memory,
    pub(crate) transforms: &'a RwLock<Transforms>,
}

impl Remembered<'_> {
    /// An entity, and where it is, root frame.
    pub(crate) async fn find(&self, id: &EntityId) -> Result<(Arc<Snapshot>, Isometry3<f64>), Failure> {
        let known = self.memory.latest(id).await.map_err(failed)?;
        let pose = self.root_pose(&known);
        Ok((known, pose.ok_or_else(|| Failure::new(format!("memory does not know where `{id}` is")))?))
    }

    /// The class of a thing, and where it is, root frame.
    pub(crate) async fn thing(&self, id: &EntityId) -> Result<(ObjectClass, Isometry3<f64>), Failure> {
        let (known, pose) = self.find(id).await?;
        Ok((class_of(self.memory, &known).await?, pose))
    }

    /// The pose that a snapshot holds, root frame: in that frame, or in one of which it is known where it stands to it, such as
    /// `world`.
    pub(crate) fn root_pose(&self, snapshot: &Snapshot) -> Option<Isometry3<f64>> {
        let value = snapshot.attribute("pose")?;
        as_pose(value).or_else(|| {
            let Value::Pose(pose) = value else { return None };
            let root_from_frame = self.transforms.read().transform(&Frame::root(), &pose.frame, NOW).ok()?;
            Some(root_from_frame * pose.isometry())
        })
    }

    /// What was observed and looked for in the root frame as memory is to hold it: in `world` where it is known where the robot stands there.
    pub(crate) fn placed(
        &self,
        seen: Vec<Observation>,
        search: Option<Search>,
    ) -> (Vec<Observation>, Option<Search>) {
        let (root, world) = (Frame::root(), Frame(WORLD.to_owned()));
        let Ok(world_from_root) = self.transforms.read().transform(&world, &root, NOW) else {
            return (seen, search);
        };
        let moved = |seen: Observation| seen.moved(&root, &world, &world_from_root);
        (seen.into_iter().map(moved).collect(), search.map(|search| search.moved(&world, &world_from_root)))
    }
}

/// What memory knows of where something is.
pub(crate) struct KnownPlace {
    pub(crate) shape: KnownBox,
    /// Its address, if it is a thing that a hand can take.
    pub(crate) thing: Option<EntityId>,
}

/// The names of the places near to one of these points (root frame, m).
pub(crate) async fn places_at(
    remembered: Remembered<'_>,
    points: &[Point3<f64>],
) -> Result<Vec<String>, Failure> {
    let near = |place: &KnownBox| points.iter().any(|point| distance(place, point) < WORKED_ON);
    Ok(places(remembered).await?.into_iter().filter(near).map(|place| place.name).collect())
}

/// What memory holds now of places and things, each with its extent. Things in a hand and what has no pose in the root frame are
/// left out, and so are things whose class nobody knows.
pub(crate) async fn known(remembered: Remembered<'_>) -> Result<Vec<KnownPlace>, Failure> {
    let memory = remembered.memory;
    let mut all: Vec<KnownPlace> =
        places(remembered).await?.into_iter().map(|shape| KnownPlace { shape, thing: None }).collect();
    for thing in memory.segment("ObjectInstances").await.map_err(failed)? {
        if thing.attribute("attached_to").is_some() {
            continue;
        }
        let Ok(class) = class_of(memory, &thing).await else { continue };
        all.extend(
            shape(remembered, &thing, class.size)
                .map(|shape| KnownPlace { shape, thing: Some(thing.id.clone()) }),
        );
    }
    Ok(all)
}

/// What memory holds now of places: tables, walls. What has no pose in the root frame or no extent is left out.
pub(crate) async fn places(remembered: Remembered<'_>) -> Result<Vec<KnownBox>, Failure> {
    places_where(remembered, |_| true).await
}

/// Of the same those for which `wanted` is true.
pub(crate) async fn places_where(
    remembered: Remembered<'_>,
    wanted: impl Fn(&Snapshot) -> bool,
) -> Result<Vec<KnownBox>, Failure> {
    let known = remembered.memory.segment(PLACES).await.map_err(failed)?;
    let place = |place: &Arc<Snapshot>| {
        let mut size = place.attribute("size").and_then(Value::as_vector3)?;
        let is_surface = size[2] == 0.0;
        if is_surface {
            size[2] = THICKNESS;
        }
        let mut shape = shape(remembered, place, size)?;
        if is_surface {
            shape.root_from_box *= Translation3::new(0.0, 0.0, -THICKNESS / 2.0);
        }
        Some(shape)
    };
    Ok(known.iter().filter(|known| wanted(known)).filter_map(place).collect())
}

/// Whether a place is the box around something that has no known surfaces.
pub(crate) fn is_bulk(place: &Snapshot) -> bool {
    place.attribute("class").and_then(Value::as_str) == Some(BulkEstimate::CLASS)
}

fn shape(remembered: Remembered<'_>, snapshot: &Snapshot, size: [f64; 3]) -> Option<KnownBox> {
    let root_from_box = remembered.root_pose(snapshot)?;
    let size = Vector3::from(size);
    let is_box = size.iter().all(|edge| edge.is_finite() && *edge > 0.0);
    let placed = root_from_box.translation.vector.iter().all(|x| x.is_finite());
    (is_box && placed).then(|| KnownBox { name: snapshot.id.entity().to_owned(), root_from_box, size })
}

/// The distance of a point from a box, m; 0 inside.
pub(crate) fn distance(known: &KnownBox, point: &Point3<f64>) -> f64 {
    distance_from_box(point, &known.root_from_box, &known.size)
}

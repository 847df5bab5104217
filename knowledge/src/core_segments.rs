//! The core segments of an agent's memory: which things it knows of, by which attributes. `memoryx` checks them, and knows none.

use armarium_memoryx::{Clock, SegmentSchema, WorkingMemory};
use armarium_values::{Type, Unit};

/// An empty working memory that checks these core segments.
pub fn working_memory(clock: Clock) -> WorkingMemory {
    WorkingMemory::new(clock).with_segments(core_segments())
}

/// The core segments that every agent's memory has, with the attributes that are checked.
pub fn core_segments() -> Vec<SegmentSchema> {
    let numbers = || Type::list(Type::FLOAT);
    let metres = || Type::quantity(Unit::M);
    vec![
        SegmentSchema::new("ObjectInstances", "Things that were seen, and where they are.")
            .required("class", Type::String, "name of its class in ObjectClasses")
            .optional("pose", Type::Pose, "pose of the object, m, in its frame")
            .optional("position", Type::Vector, "centre of the object, m, in its frame")
            .optional("velocity", Type::Vector, "velocity of the centre, m/s, in its frame")
            .optional("attached_to", Type::String, "what it moves with: a hand or another object")
            .optional(
                "motion_model",
                Type::String,
                "static, hand or object: how it moves between observations",
            )
            .optional("alternatives", numbers(), "confidences of other matches that were considered, 0 to 1"),
        SegmentSchema::new("ObjectHypotheses", "What may be a thing of its own, of which nothing is known yet.")
            .required("pose", Type::Pose, "pose of the middle of its box, m, z up, x along the longer edge")
            .required("size", Type::list(metres()), "extent of that box along its x, y and z, m")
            .required("color", numbers(), "its mean colour: red, green and blue, 0 to 255")
            .required("points", Type::Bytes, "its upper surface, as `visionx` packs it")
            .required("mask", Type::list(Type::Int), "its pixels in the left picture: row, first column, one past the last, ...")
            .required("confirmed", Type::Bool, "whether it is taken for one thing, as it has moved as one")
            .required("pushes", Type::Int, "how often it was pushed")
            .optional("class", Type::String, "the learned class of which it is taken to be"),
        SegmentSchema::new("Touches", "That a hand of the robot touched something on its way; the entity is the hand.")
            .required("by", Type::one_of(["seen", "felt"]), "how that was noticed")
            .required("finger", Type::String, "the link of the finger that touched; empty where that is not known")
            .optional("position", Type::Vector, "middle of what was seen to move, m, in its frame"),
        SegmentSchema::new("Slips", "That what a hand of the robot held slipped; the entity is the hand.")
            .required("by", Type::one_of(["seen", "felt"]), "how that was noticed")
            .optional("position", Type::Vector, "where it slipped, m, in its frame"),
        SegmentSchema::new("ObjectClasses", "What is known of a kind of thing before it is seen.")
            .required("color", numbers(), "red, green and blue, 0 to 255")
            .required("size", Type::list(metres()), "extent along the object's x, y and z, m")
            .required("recognition", Type::String, "the method that finds it in images")
            .optional("mass", Type::quantity(Unit::KG), "mass, kg")
            .optional("description", Type::String, "a sentence for people")
            .optional("grasps", Type::list(grasp()), "hand poses in the object's frame")
            .optional("appearance", numbers(), "of a learned one: by what it is known again, as `visionx` says")
            .optional("points", Type::Bytes, "of a learned one: its upper surface where it was learned, as `visionx` packs it"),
        SegmentSchema::new("ObjectRelations", "How things stand to each other.")
            .required("subject", Type::String, "address of the one")
            .required("relation", Type::String, "on, in, near, left_of ...")
            .required("object", Type::String, "address of the other"),
        SegmentSchema::new("AgentInstances", "The agents, and where they stand.")
            .optional("pose", Type::Pose, "pose of the agent's root frame, m")
            .optional("joints", Type::map(Type::FLOAT), "joint positions by name, rad"),
        SegmentSchema::new("EnvironmentModels", "Tables, walls and other places.")
            .optional("pose", Type::Pose, "pose of the model, m")
            .optional("size", Type::list(metres()), "extent along its x, y and z, m")
            .optional(
                "plane_covariance",
                numbers(),
                "of a flat surface: nine numbers, covariance of its height along its z, m, and its slopes along its x and y, rad",
            ),
        SegmentSchema::new("Grasps", "Grasps that were tried.")
            .required("object", Type::String, "address or class of the object")
            .optional("pose", Type::Pose, "pose of the hand in the object's frame, m")
            .optional("success", Type::Bool, "whether the object was held"),
        SegmentSchema::new("Motions", "Movement primitives that were learned.")
            .optional("kind", Type::String, "which primitive")
            .optional("frequency", Type::quantity(Unit::HZ), "of a periodic motion, Hz"),
        SegmentSchema::new("HumanHands", "Hands of people, and what they show.")
            .optional("gesture", Type::String, "none, fist, open_hand, point_one or point_two")
            .optional("position", Type::Vector, "centre of the palm, m, in its frame")
            .optional("direction", Type::Vector, "unit vector along the pointing finger, in its frame")
            .optional(
                "fingertips",
                Type::list(Type::Vector),
                "stretched fingers in order around the palm, m, in their frame",
            )
            .optional("hidden", Type::FLOAT, "share of the outline that something hides, 0 to 1")
            .optional(
                "shown",
                Type::map(Type::Any),
                "gesture that was clearly visible, for how long (s), position and direction then, and where the hand was seen last",
            ),
        SegmentSchema::new("HumanPoses", "Bodies of people.")
            .optional("position", Type::Vector, "middle of the shoulders, m, in its frame")
            .optional("keypoints", Type::map(Type::Vector), "joints of the body by name, m, in their frame")
            .optional(
                "covariances",
                Type::map(numbers()),
                "nine numbers for each of these joints: its covariance in the root frame, m², row by row",
            ),
    ]
}

fn grasp() -> Type {
    Type::record([("name", Type::String), ("pose", Type::Pose)])
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use armarium_memoryx::{EntityId, Instance};
    use armarium_values::{Frame, Pose, Value, Vector};

    use super::*;

    fn complaint(segment: &str, attributes: &[(&str, Value)]) -> String {
        let id = EntityId::new(segment, "p", "e").unwrap();
        let attributes: BTreeMap<String, Value> =
            attributes.iter().map(|(k, v)| ((*k).to_owned(), v.clone())).collect();
        let segments = core_segments();
        let schema = segments.iter().find(|schema| schema.segment == segment).unwrap();
        match schema.check(&id, &Instance::new(attributes)) {
            Ok(()) => "fits".into(),
            Err(error) => error.to_string(),
        }
    }

    #[test]
    fn typed_segments_check_what_they_name_and_leave_the_rest_free() {
        let at = |x: f64| Value::Vector(Vector { frame: Frame::root(), components: [x, 0.0, 0.0] });
        let class = ("class", Value::from("sponge"));
        let turned = |w: f64| {
            let pose = Pose { frame: Frame::root(), position: [0.0; 3], orientation: [0.0, 0.0, 0.0, w] };
            Value::Pose(pose)
        };
        let refused =
            |what: &str| format!("`ObjectInstances/p/e` does not fit the core segment: attribute {what}");
        for (attributes, expected) in [
            (vec![class.clone(), ("position", at(1.0)), ("smell", Value::Null)], "fits".to_owned()),
            (vec![], refused("`class` is missing: name of its class in ObjectClasses")),
            (vec![("class", Value::Int(3))], refused("`class` is the int 3, where string is wanted")),
            (vec![class.clone(), ("position", at(f64::NAN))], refused("`position` is not finite")),
            (
                vec![class.clone(), ("pose", turned(0.5))],
                refused("`pose` has an orientation that is not a unit quaternion"),
            ),
            (
                vec![class, ("alternatives", Value::List(vec![1.0.into(), "x".into()]))],
                refused("`alternatives[1]` is the string \"x\", where float is wanted"),
            ),
        ] {
            assert_eq!(complaint("ObjectInstances", &attributes), expected);
        }
    }
}

//! What a robot lacks for which skill: the parts that skills look for in its description.

use armarium_robot::Model;

/// A part that a robot does not have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lack {
    /// What is missing, as it would stand in the robot file.
    pub what: String,
    /// The skills that cannot run without it.
    pub skills: &'static [&'static str],
}

const ARM: &[&str] =
    &["MoveJoints", "MoveTcp", "MoveTcpBy", "ImitateMotion", "PlayMotion", "PushObject", "ApproachObject"];
const HAND: &[&str] = &[
    "OpenHand",
    "CloseHand",
    "PlanGrasp",
    "PlanPut",
    "VisualServoTowardsTargetPose",
    "BimanualVisualServo",
    "VerifyGrasp",
    "AttachObject",
    "CalibrateHandEye",
    "ChoosePush",
    "PushObject",
    "ApproachObject",
    "WatchGrasp",
];
const WRENCH: &[&str] = &[
    "Tare",
    "WeighHand",
    "VerifyGrasp",
    "ForceAdaptation",
    "ExecuteMotion",
    "ForceCoaching",
    "ForceGuiding",
    "SqueezeTogether",
    "CarryTogether",
    "LearnTogether",
    "PutDownTogether",
    "PushObject",
    "ApproachObject",
];
const TWO_ARMS: &[&str] =
    &["SqueezeTogether", "BimanualVisualServo", "CarryTogether", "LearnTogether", "PutDownTogether"];
const PRESS: &[&str] = &["SqueezeTogether", "CarryTogether", "LearnTogether", "PutDownTogether"];
const MARKER: &[&str] = &["VisualServoTowardsTargetPose", "BimanualVisualServo"];
const CAMERAS: &[&str] = &[
    "LocateObject",
    "CalibrateHandEye",
    "VisualServoTowardsTargetPose",
    "BimanualVisualServo",
    "VerifyGrasp",
    "MovementImitation",
    "VisionCoaching",
    "BodyCoaching",
    "LookAt",
    "LookAround",
    "LevelCameras",
    "ModelEnvironment",
    "GazeSelection",
    "ApproachObject",
    "WatchGrasp",
];

/// What a robot lacks, and for which skills.
pub fn lacks(model: &Model) -> Vec<Lack> {
    let mut lacks = Vec::new();
    let mut lack = |what: String, skills| lacks.push(Lack { what, skills });
    if model.arms().next().is_none() {
        lack("no group has a `tcp`".to_owned(), ARM);
    }
    if model.arms().count() < 2 {
        lack("no second group has a `tcp`".to_owned(), TWO_ARMS);
    }
    for arm in model.arms() {
        let name = &arm.name;
        if arm.wrench.is_none() {
            lack(format!("no `wrench` for `{name}`"), WRENCH);
        }
        match model.hand_of(arm) {
            None => lack(format!("no `hand` for `{name}`"), HAND),
            Some(hand) => {
                if hand.marker.is_none() {
                    lack(format!("no `marker` on `{}`", hand.name), MARKER);
                }
                if hand.press_in_tcp.is_none() {
                    lack(format!("no `press_in_tcp` on `{}`", hand.name), PRESS);
                }
            }
        }
    }
    if model.camera().is_none() {
        lack("no `cameras`".to_owned(), CAMERAS);
    }
    lacks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_robot_file_is_told_what_it_lacks() {
        let model = Model::shipped("armar3").unwrap();
        let lacks: Vec<String> = lacks(&model).into_iter().map(|lack| lack.what).collect();
        assert!(lacks.is_empty(), "{lacks:?}");
    }
}

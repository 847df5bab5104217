//! All skills, by name. A new one is a file here and a line in [`skills`].

mod approach_object;
mod attach_object;
mod attend_to;
mod bimanual_servo;
mod body_coaching;
mod calibrate_hand_eye;
mod carry_together;
mod choose_push;
mod close_hand;
mod execute_motion;
mod follow_object;
mod force_adaptation;
mod force_coaching;
mod force_guiding;
mod gaze_selection;
mod hold_still;
mod imitate_motion;
mod keep_motion;
mod learn_things;
mod learn_together;
mod level_cameras;
mod locate_object;
mod look_around;
mod look_at;
mod model_environment;
mod move_joints;
mod move_platform;
mod move_tcp;
mod move_tcp_by;
mod movement_imitation;
mod open_hand;
mod plan_grasp;
mod plan_put;
mod play_motion;
mod push_object;
mod put_down_together;
mod recall_motion;
mod recall_object;
mod recognize_things;
mod reset_stop;
mod segment_scene;
mod shape_hand;
mod squeeze_together;
mod tare;
mod verify_grasp;
mod vision_coaching;
mod visual_servo;
mod watch_grasp;
mod weigh_hand;

use std::sync::Arc;

use armarium_runtime::skill::Skill;

use crate::equipment::Equipment;

/// All skills of this room, with their `equipment`.
pub fn skills(equipment: &Equipment) -> Vec<Arc<dyn Skill>> {
    macro_rules! with_equipment {
        ($($skill:ident)*) => { vec![$(Arc::new($skill::skill(equipment))),*] };
    }
    with_equipment![
        move_joints move_platform move_tcp move_tcp_by follow_object hold_still
        look_at look_around level_cameras model_environment
        open_hand close_hand calibrate_hand_eye locate_object recall_object plan_grasp plan_put
        approach_object visual_servo bimanual_servo
        tare reset_stop shape_hand weigh_hand verify_grasp watch_grasp attach_object
        movement_imitation imitate_motion recall_motion keep_motion
        force_adaptation execute_motion play_motion force_coaching force_guiding
        squeeze_together carry_together learn_together put_down_together
        vision_coaching body_coaching gaze_selection attend_to
        segment_scene choose_push push_object learn_things recognize_things
    ]
}

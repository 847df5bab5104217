//! All skills, by name. A new one is a file here and a line in [`skills`].

mod attach_object;
mod calibrate_hand_eye;
mod carry_together;
mod close_hand;
mod execute_motion;
mod force_adaptation;
mod force_coaching;
mod force_guiding;
mod imitate_motion;
mod keep_motion;
mod learn_together;
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
mod play_motion;
mod put_down_together;
mod recall_motion;
mod recall_object;
mod reset_stop;
mod shape_hand;
mod squeeze_together;
mod tare;
mod verify_grasp;
mod vision_coaching;
mod visual_servo;
mod watch_coach;
mod weigh_hand;

use std::sync::Arc;

use armarium_runtime::skill::Skill;

use crate::equipment::Equipment;

/// All skills of this room, with their `equipment`.
pub fn skills(equipment: &Equipment) -> Vec<Arc<dyn Skill>> {
    vec![
        move_joints::skill(equipment),
        move_platform::skill(equipment),
        move_tcp::skill(equipment),
        move_tcp_by::skill(equipment),
        look_at::skill(equipment),
        look_around::skill(equipment),
        model_environment::skill(equipment),
        open_hand::skill(equipment),
        close_hand::skill(equipment),
        calibrate_hand_eye::skill(equipment),
        locate_object::skill(equipment),
        recall_object::skill(equipment),
        plan_grasp::skill(equipment),
        visual_servo::skill(equipment),
        tare::skill(equipment),
        reset_stop::skill(equipment),
        shape_hand::skill(equipment),
        weigh_hand::skill(equipment),
        verify_grasp::skill(equipment),
        attach_object::skill(equipment),
        movement_imitation::skill(equipment),
        imitate_motion::skill(equipment),
        recall_motion::skill(equipment),
        keep_motion::skill(equipment),
        force_adaptation::skill(equipment),
        execute_motion::skill(equipment),
        play_motion::skill(equipment),
        force_coaching::skill(equipment),
        force_guiding::skill(equipment),
        squeeze_together::skill(equipment),
        carry_together::skill(equipment),
        learn_together::skill(equipment),
        put_down_together::skill(equipment),
        vision_coaching::skill(equipment),
        watch_coach::skill(equipment),
    ]
}

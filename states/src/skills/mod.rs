//! All skills, by name. A new one is a file here and a line in [`skills`].

mod approach_object;
mod attach_object;
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
mod weigh_hand;

use std::sync::Arc;

use armarium_runtime::skill::Skill;

use crate::equipment::Equipment;

/// All skills of this room, with their `equipment`.
pub fn skills(equipment: &Equipment) -> Vec<Arc<dyn Skill>> {
    vec![
        Arc::new(move_joints::skill(equipment)),
        Arc::new(move_platform::skill(equipment)),
        Arc::new(move_tcp::skill(equipment)),
        Arc::new(move_tcp_by::skill(equipment)),
        Arc::new(follow_object::skill(equipment)),
        Arc::new(hold_still::skill(equipment)),
        Arc::new(look_at::skill(equipment)),
        Arc::new(look_around::skill(equipment)),
        Arc::new(model_environment::skill(equipment)),
        Arc::new(open_hand::skill(equipment)),
        Arc::new(close_hand::skill(equipment)),
        Arc::new(calibrate_hand_eye::skill(equipment)),
        Arc::new(locate_object::skill(equipment)),
        Arc::new(recall_object::skill(equipment)),
        Arc::new(plan_grasp::skill(equipment)),
        Arc::new(approach_object::skill(equipment)),
        Arc::new(visual_servo::skill(equipment)),
        Arc::new(bimanual_servo::skill(equipment)),
        Arc::new(tare::skill(equipment)),
        Arc::new(reset_stop::skill(equipment)),
        Arc::new(shape_hand::skill(equipment)),
        Arc::new(weigh_hand::skill(equipment)),
        Arc::new(verify_grasp::skill(equipment)),
        Arc::new(attach_object::skill(equipment)),
        Arc::new(movement_imitation::skill(equipment)),
        Arc::new(imitate_motion::skill(equipment)),
        Arc::new(recall_motion::skill(equipment)),
        Arc::new(keep_motion::skill(equipment)),
        Arc::new(force_adaptation::skill(equipment)),
        Arc::new(execute_motion::skill(equipment)),
        Arc::new(play_motion::skill(equipment)),
        Arc::new(force_coaching::skill(equipment)),
        Arc::new(force_guiding::skill(equipment)),
        Arc::new(squeeze_together::skill(equipment)),
        Arc::new(carry_together::skill(equipment)),
        Arc::new(learn_together::skill(equipment)),
        Arc::new(put_down_together::skill(equipment)),
        Arc::new(vision_coaching::skill(equipment)),
        Arc::new(body_coaching::skill(equipment)),
        Arc::new(gaze_selection::skill(equipment)),
        Arc::new(segment_scene::skill(equipment)),
        Arc::new(choose_push::skill(equipment)),
        Arc::new(push_object::skill(equipment)),
        Arc::new(learn_things::skill(equipment)),
        Arc::new(recognize_things::skill(equipment)),
    ]
}

//! What an agent knows of the things around it, and how it comes to know it. What is known lies in a memory
//! ([`armarium_memoryx`]), which knows no kind of thing.
//!
//! - [`AgentMemory`]: all parts of an agent's memory, put together.
//! - [`PriorKnowledge`]: object classes and scenes, known before anything is seen.
//! - [`updater`]: turns observations into entities: matching, fusion, motion models.
//! - [`Inference`]: conclusions from memory, with confidence and provenance.
//! - [`Following`]: a copy of another agent's knowledge, in one's own frame.
//!
//! This room knows no image, no robot and no file of long-term memory.

mod agent;
pub mod infer;
pub mod prior;
pub mod share;
pub mod updater;

pub use agent::{AgentMemory, MemoryConfig, Restored};
pub use infer::{Conclusion, Inference, RunningInference, SpatialRelations, UsualPlaces};
pub use prior::{GraspPose, ObjectClass, PriorKnowledge, Recognition};
pub use share::{
    FollowSettings, FollowedAgent, Followee, Following, FollowingAgent, WORLD, agent_pose_update,
};

#[path = "../../memoryx/tests/proxy.rs"]
#[cfg(test)]
mod proxy;

//! What an agent knows of the things around it, and how it comes to know it. What is known lies in a memory
//! ([`armarium_memoryx`]), which does not interpret it.
//!
//! - [`AgentMemory`]: all parts of an agent's memory, put together; it follows other agents, whose knowledge it has in its
//!   own frame.
//! - [`core_segments`]: the core segments of its memory, with the attributes that are checked.
//! - [`PriorKnowledge`]: object classes and scenes, known before anything is seen.
//! - [`updater`]: turns observations into entities: matching, fusion, motion models.
//! - [`Inference`]: conclusions from memory, with confidence and provenance.
//!
//! This room knows no image and no robot.

mod agent;
mod core_segments;
pub mod infer;
pub mod prior;
mod share;
pub mod updater;

pub use agent::{AgentMemory, MemoryConfig, Restored, ServedMemory};
pub use core_segments::{core_segments, working_memory};
pub use infer::{Conclusion, Inference, RunningInference, SpatialRelations, UsualPlaces};
pub use prior::{GraspPose, ObjectClass, PriorKnowledge, Recognition};
pub use share::{FOLLOWING, FollowedAgent, Followee, Following, Origin, WORLD, agent_pose_update};

#[path = "../../memoryx/tests/proxy.rs"]
#[cfg(test)]
mod proxy;

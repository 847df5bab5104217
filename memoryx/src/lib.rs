//! MemoryX: working memory, long-term memory and prior knowledge.
//!
//! - [`Memory`]: the one interface, in process and over Zenoh; [`modify`] reads, changes and writes an entity.
//! - [`EntityId`], [`Snapshot`], [`Commit`]: the data model; [`Query`]: what can be asked.
//! - [`WorkingMemory`]: what an agent knows now.
//! - [`Follower`]: a subscription that reports its gaps.
//! - [`PriorKnowledge`]: object classes and scenes, known before anything is seen.
//! - [`MemoryServer`], [`RemoteMemory`]: a memory shared over Zenoh ([`wire`] has the messages).
//! - [`Following`]: a copy of another agent's knowledge, in one's own frame; [`AgentMemory`]: all parts of an agent's
//!   memory.
//! - [`updater`]: turns observations into entities: matching, fusion, motion models.
//! - [`Inference`]: conclusions from memory, with confidence and provenance.
//! - [`LongTermMemory`]: storage on disk; [`Consolidator`] decides what is stored.
//!
//! This room knows no robot and no image.

mod agent;
mod attributes;
mod awaited_thread;
mod changes;
mod checked_query;
mod entity;
mod error;
mod filter;
mod follow;
pub mod infer;
pub mod maintain;
mod memory;
mod place;
pub mod prior;
mod query;
mod remote;
mod schema;
mod server;
pub mod share;
mod store;
mod time_of;
pub mod updater;
pub mod wire;
mod working;

pub use agent::{AgentMemory, MemoryConfig, Restored};
pub use attributes::Attributes;
pub use changes::Changes;
pub use checked_query::{Answer, CheckedQuery};
pub use entity::{Commit, EntityId, Instance, Snapshot, check_name};
pub use error::MemoryError;
pub use filter::Filter;
pub use follow::{Change, Follower, LastSeen};
pub use infer::{Conclusion, Inference, RunningInference, SpatialRelations, UsualPlaces};
pub use memory::{Head, Heads, Memory, Pages, modify, pages};
pub use place::{SpatialRegion, distance, place_of};
pub use prior::{GraspPose, ObjectClass, PriorKnowledge, Recognition};
pub use query::{Cursor, Pattern, Query, Times};
pub use remote::RemoteMemory;
pub use schema::{Attribute, SegmentSchema, core_segments};
pub use server::{MemoryServer, ServerOptions};
pub use share::{
    FollowSettings, FollowedAgent, Followee, Following, FollowingAgent, WORLD, agent_pose_update,
};
pub use store::{
    Coding, Consolidator, Dropped, EntityChange, LongTermMemory, NamedSnapshot, Policies, Policy, Retention,
    StoreError, StoreStats, Verification,
};
pub use time_of::TimeOf;
pub use working::{Archive, Backing, Clock, MemoryLimits, WorkingMemory, tokio_clock};

#[cfg(test)]
mod conformance_tests;
#[cfg(test)]
mod hostile_tests;
#[path = "../tests/proxy.rs"]
#[cfg(test)]
mod proxy;
#[cfg(test)]
mod working_tests;

//! MemoryX: working memory, long-term memory, prior knowledge and the observer.
//!
//! - [`Memory`]: the one interface, in process and over Zenoh; [`modify`] changes an entity by what it is.
//! - [`EntityId`], [`Snapshot`], [`Commit`]: what is kept and how it gets in; [`Query`]: what can be asked.
//! - [`WorkingMemory`]: what an agent knows now.
//! - [`Follower`]: a subscription that says what it missed.
//! - [`PriorKnowledge`]: object classes and scenes, known before one is seen.
//! - [`MemoryServer`], [`RemoteMemory`]: a memory shared over Zenoh ([`wire`] says how).
//! - [`Following`]: what another agent knows, in one's own frame; [`AgentMemory`]: all of it, put together.
//! - [`updater`]: observations become entities: matching, fusion, motion models.
//! - [`Observer`]: conditions on memory that become events.
//! - [`Inference`]: what is concluded from all of it, with confidence and provenance.
//! - [`LongTermMemory`]: what is kept on disk; [`Consolidator`] decides what.
//!
//! This room knows no robot and no image.

mod agent;
mod attributes;
mod checked_query;
pub mod conformance;
mod entity;
mod error;
mod filter;
mod follow;
pub mod infer;
pub mod maintain;
mod memory;
mod observer;
mod place;
pub mod prior;
mod query;
mod remote;
mod schema;
mod server;
pub mod share;
mod store;
pub mod updater;
pub mod wire;
mod working;

pub use agent::{AgentConfig, AgentMemory, Restored};
pub use attributes::Attributes;
pub use checked_query::CheckedQuery;
pub use entity::{Commit, EntityId, Instance, Snapshot, check_name};
pub use error::MemoryError;
pub use filter::Filter;
pub use follow::{Change, Follower, LastSeen};
pub use infer::{Attached, Conclusion, Inference, SpatialRelations, UsualPlaces};
pub use memory::{Memory, Pages, modify, pages};
pub use observer::{Condition, MemoryEvent, Observer};
pub use place::{Region, distance, place_of};
pub use prior::{GraspPose, ObjectClass, PriorKnowledge, Recognition};
pub use query::{Cursor, Pattern, Query, Times};
pub use remote::RemoteMemory;
pub use schema::{Attribute, SegmentSchema, core_segments};
pub use server::MemoryServer;
pub use share::{FollowSettings, FollowedAgent, Followee, Following, FollowingAgent, agent_stands};
pub use store::{
    Coding, Consolidator, Dropped, LongTermMemory, Named, Numbering, Policies, Policy, Retention, Step,
    StoreError, StoreStats, Verification,
};
pub use working::{Backing, Clock, Kept, Limits, WorkingMemory, tokio_clock};

#[cfg(test)]
mod hostile_tests;
#[cfg(test)]
mod line;
#[cfg(test)]
mod working_tests;

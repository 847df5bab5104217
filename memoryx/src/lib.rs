//! MemoryX: working memory and long-term memory.
//!
//! - [`Memory`]: the one interface, in process and over Zenoh; [`modify`] reads, changes and writes an entity.
//! - [`EntityId`], [`Snapshot`], [`Commit`]: the data model; [`Query`]: what can be asked.
//! - [`WorkingMemory`]: what an agent knows now.
//! - [`Follower`]: a subscription that reports its gaps.
//! - [`MemoryServer`], [`RemoteMemory`]: a memory shared over Zenoh ([`wire`] has the messages).
//! - [`LongTermMemory`]: storage on disk; [`Consolidator`] decides what is stored.
//!
//! Of things this room knows only where they are, the name of their class, and when they expire: no core segment, no robot, no image.

mod attributes;
mod awaited_thread;
mod changes;
mod checked_query;
mod entity;
mod error;
mod filter;
mod follow;
pub mod maintain;
mod memory;
mod place;
mod query;
mod remote;
mod schema;
mod server;
mod store;
mod time_of;
pub mod wire;
mod working;

pub use attributes::{Attributes, fields};
pub use changes::Changes;
pub use checked_query::{Answer, CheckedQuery};
pub use entity::{Commit, EntityId, Instance, Snapshot, check_name};
pub use error::MemoryError;
pub use filter::Filter;
pub use follow::{Change, Follower, LastSeen};
pub use memory::{Head, Heads, Memory, Pages, modify, pages};
pub use place::{SpatialRegion, distance, place_of};
pub use query::{Cursor, Pattern, Query, Times};
pub use remote::RemoteMemory;
pub use schema::{Attribute, SegmentSchema};
pub use server::{MemoryServer, ServerOptions};
pub use store::{
    Coding, Consolidator, Dropped, EntityChange, Loading, LongTermMemory, NamedSnapshot, Policies, Policy,
    Retention, StoreError, StoreStats, Verification,
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

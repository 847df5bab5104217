//! MemoryX: working memory, long-term memory, prior knowledge and the observer.
//!
//! - [`Memory`]: the one interface, in process and over Zenoh.
//! - [`EntityId`], [`Snapshot`], [`Commit`]: what is kept and how it gets in.
//!
//! This room knows no robot and no image.

mod entity;

pub use entity::{Commit, EntityId, Instance, Memory, MemoryError, Snapshot};

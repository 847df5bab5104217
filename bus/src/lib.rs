//! Communication between agents: the CBOR codec, the keys, and the Zenoh session with its security.
//!
//! - [`codec`]: values to bytes, deterministic, and back, hardened against bad input; [`Schema`] names the type of a
//!   payload.
//! - [`keys`]: every key, as a checked type.
//! - [`bulk`]: large payloads through shared memory on one machine, over the network otherwise.
//! - [`control`]: small messages at once, for control loops.
//! - [`Access`]: access rules by certificate.
//! - [`stream`]: numbered messages, so that a reader notices gaps and can query the missing ones.
//! - [`session`]: on loopback by default; bounded queues that count what they drop.
//!
//! This room knows no memory, robot, image or chart: it transports bytes.

mod access;
pub mod bulk;
pub mod codec;
mod config;
pub mod control;
mod error;
pub mod keys;
mod message;
mod per_asker;
mod queue;
mod schema;
mod segments;
pub mod session;
pub mod stream;
mod turns;

pub use access::Access;
pub use codec::{Bounds, CodecError, decode, decode_within, encode};
pub use error::SessionError;
pub use keys::{Key, KeyError, KeyPattern};
pub use per_asker::PerAsker;
pub use schema::{Payload, Schema};
pub use session::{
    AliveToken, Boxed, IncomingQuery, Interest, Liveliness, LivelinessSubscription, Message, Mode, Queryable,
    Reply, Session, SessionConfig, Subscription, Tls,
};
pub use turns::aside;

#[cfg(test)]
mod loopback_tests;

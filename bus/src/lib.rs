//! What agents speak over: the CBOR codec, the keys, and the Zenoh session with its security.
//!
//! - [`codec`]: bytes from values and back, deterministic one way and hardened the other; [`Schema`] names what a
//!   payload holds.
//! - [`keys`]: every key, as a checked type.
//! - [`bulk`]: large payloads through shared memory on one machine, over the network otherwise.
//! - [`Access`]: who may say and ask what, as rules by certificate.
//! - [`stream`]: numbers by which a reader notices what did not come, and asks for it again.
//! - [`session`]: on loopback unless more is asked for; bounded queues that count what they drop.
//!
//! This room knows no memory, robot, image or chart: it carries bytes for those that do.

mod access;
mod attached;
pub mod bulk;
pub mod codec;
mod config;
mod error;
pub mod keys;
mod message;
mod queue;
mod schema;
pub mod session;
pub mod stream;

pub use access::Access;
pub use codec::{Bounds, CodecError, decode, decode_within, encode};
pub use error::SessionError;
pub use keys::{Key, KeyError, KeyPattern};
pub use schema::{Payload, Schema};
pub use session::{
    AliveToken, Answer, Interest, Liveliness, Message, Mode, Question, Questions, Roll, Session,
    SessionConfig, Subscription, Tls,
};

#[cfg(test)]
mod loopback_tests;

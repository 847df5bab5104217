//! Charts and skills of other agents: what one process offers, another starts as a state of its own chart.
//!
//! - [`wire`]: the messages, as `docs/wire.md` explains them to other languages;
//! - [`serve()`] offers skills (charts are skills here, see [`ChartSkill`](crate::exec::ChartSkill));
//! - [`Agents`] asks others what they offer, and starts it; it also takes events to their charts, which [`hear()`] them.
//!
//! Whoever starts something polls it; the polls are the lease for both sides. A side that has not heard of the other
//! for [`LEASE`] takes it for lost: the caller's state fails, and what was started is cancelled.
//!
//! All this happens in real time, whatever clock the charts run by.

mod agents;
mod call;
mod events;
mod serve;
pub mod wire;

pub use agents::{Agents, Patience};
pub use events::hear;
pub use serve::{Offer, Offers, ServeError, serve};

use std::time::Duration;

/// How long a side may be silent before it is taken for lost.
pub const LEASE: Duration = Duration::from_millis(500);
/// How long an answer to a poll may be held back, waiting for something to tell.
const HELD: Duration = Duration::from_millis(100);

#[cfg(test)]
mod tests;

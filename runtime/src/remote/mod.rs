//! Charts and skills of other agents: one process offers them, another starts them as a state of its own chart.
//!
//! - [`wire`]: the messages; `docs/wire.md` explains them for other languages;
//! - [`serve()`] offers skills (charts are skills here, see [`ChartSkill`](crate::exec::ChartSkill));
//! - [`Agents`] queries what other agents offer, and starts it. It also sends events to their charts, which receive
//!   them through [`receive_events()`].
//!
//! The caller polls what it has started; each poll renews the lease for both sides. A side that has not heard from
//! the other for [`LEASE`] considers it lost: the caller's state fails, and the called skill is cancelled.
//!
//! All this happens in real time, whatever clock the charts use.

mod agents;
mod call;
mod events;
mod serve;
pub mod wire;

pub use agents::Agents;
pub use events::receive_events;
pub use serve::{Offer, Offers, ServeError, serve};

use std::time::Duration;

/// How long a side may be silent before it counts as lost.
pub const LEASE: Duration = Duration::from_millis(500);
/// How long the answer to a poll may be delayed while there is nothing new.
const MAX_POLL_WAIT: Duration = Duration::from_millis(100);

#[cfg(test)]
mod tests;

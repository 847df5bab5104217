//! Subscribes to the channels that armed watches read, so that observers publish them.

use std::collections::BTreeMap;

use futures::future::select_all;
use tokio::sync::watch::Receiver;

use crate::channels::{ChannelSample, Channels, Demand};

#[derive(Debug)]
struct Followed {
    receiver: Receiver<Option<ChannelSample>>,
    _demand: Demand,
}

/// See the module; channels are given by their numbers in the program.
#[derive(Debug, Default)]
pub(super) struct Following(BTreeMap<u32, Followed>);

impl Following {
    /// Follows exactly these channels. `names` are the program's.
    pub(super) fn follow(
        &mut self,
        wanted: impl Iterator<Item = u32> + Clone,
        names: &[String],
        channels: &Channels,
    ) {
        if self.0.keys().copied().eq(wanted.clone()) {
            return;
        }
        let mut before = std::mem::take(&mut self.0);
        for channel in wanted {
            let Some(name) = names.get(channel as usize) else { continue };
            let followed = before.remove(&channel).unwrap_or_else(|| Followed {
                receiver: channels.subscribe(name),
                _demand: channels.demand(name),
            });
            self.0.insert(channel, followed);
        }
    }

    /// Whether no channel is followed.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The channels that have a new value since the last call.
    pub(super) fn take_changed(&mut self) -> Vec<u32> {
        let mut changed = Vec::new();
        for (channel, followed) in &mut self.0 {
            if followed.receiver.has_changed().unwrap_or(false) {
                followed.receiver.mark_unchanged();
                changed.push(*channel);
            }
        }
        changed
    }

    /// Waits until a channel has a new value.
    pub(super) async fn changed(&mut self) {
        let waits = self.0.values_mut().map(|followed| {
            Box::pin(async {
                if followed.receiver.changed().await.is_err() {
                    // The demand keeps the channel alive. If it were gone, nothing would be published any more.
                    std::future::pending::<()>().await;
                }
                followed.receiver.mark_changed();
            })
        });
        select_all(waits).await;
    }
}

//! The channels that the charts of a library know: those of the program, and those that the charts declare for their own
//! skills.
//!
//! All charts of a run share the channels: two that declare one name differently would read each other's values as what they
//! are not.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_source::{Finding, Findings, code};

use super::catalog::ChannelSchema;
use super::library::Library;
use super::model::{Chart, DeclaredChannel};

impl Library {
    /// The channels of the program, `known`, and those that the charts declare. A name that is declared twice stands for what
    /// it stands for first; the check finds it.
    #[must_use]
    pub fn channels(&self, known: &ChannelSchema) -> ChannelSchema {
        channels(self, known).0
    }
}

/// The channels that charts know, and what is wrong with how they are declared.
pub(super) fn channels(library: &Library, known: &ChannelSchema) -> (ChannelSchema, Vec<Finding>) {
    let mut schema = known.clone();
    let mut found = Vec::new();
    let mut declared: BTreeMap<&str, (&Chart, &DeclaredChannel)> = BTreeMap::new();
    let root = library.charts.get(&library.root);
    let others = library.charts.values().filter(|chart| chart.name != library.root);
    for chart in root.into_iter().chain(others) {
        let mut findings = Findings::new(Arc::clone(&chart.source));
        for channel in &chart.channels {
            let name = channel.name.text.as_str();
            if known.get(name).is_some() {
                let message =
                    format!("there is a channel `{name}` already: observers or skills that ship publish it");
                let help = "choose another name; `armarium channels` lists those that ship".to_owned();
                findings.error_help(code::DUPLICATE, channel.name.span, message, Some(help));
                continue;
            }
            match declared.get(name) {
                None => {
                    declared.insert(name, (chart, channel));
                    schema.add(channel.described.clone());
                }
                Some((_, first)) if first.described.ty == channel.described.ty => {}
                Some((by, first)) => {
                    let place = by.source.place(first.name.span.start);
                    let (ty, other) = (&channel.described.ty, &first.described.ty);
                    let message =
                        format!("the channel `{name}` is {ty} here, and {other} in {}, {place}", by.name);
                    let help = "all charts of a run share one channel of a name: declare it in the same way"
                        .to_owned();
                    findings.error_help(code::DUPLICATE, channel.name.span, message, Some(help));
                }
            }
        }
        found.append(&mut findings.list);
    }
    (schema, found)
}

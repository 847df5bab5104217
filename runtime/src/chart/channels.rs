//! The channels that the charts of a library know: those of the program, those that the charts declare for their own skills,
//! and what each chart observes of memory.
//!
//! All charts of a run share the channels of skills: two that declare one name differently would read each other's values as
//! what they are not. What a chart observes only its own expressions see, under the names that it gives.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_source::{Finding, Findings, Remedy, Severity, Span, code};
use armarium_values::Type;
use armarium_values::expr::nearest;

use super::catalog::{ChannelDescription, ChannelSchema};
use super::library::Library;
use super::model::{Chart, DeclaredChannel, WrittenPattern};
use crate::observed::{ALL, MemoryPattern};
use crate::skill::Parameter;

/// The channels that the charts of a library can name.
#[derive(Debug, Default)]
pub(super) struct KnownChannels {
    /// Those that all charts share.
    pub(super) shared: ChannelSchema,
    /// What each chart observes, by the chart's name and the name that its expressions use.
    observed: BTreeMap<(String, String), ObservedChannel>,
}

/// A channel that holds what a chart observes of memory.
#[derive(Debug)]
pub(super) struct ObservedChannel {
    /// The name under `observe`.
    pub(super) declared: String,
    pub(super) pattern: MemoryPattern,
    /// Whether it is the list of all matches.
    pub(super) all: bool,
    pub(super) described: ChannelDescription,
}

impl KnownChannels {
    /// What a chart observes under this name.
    pub(super) fn observed(&self, chart: &str, name: &str) -> Option<&ObservedChannel> {
        self.observed.get(&(chart.to_owned(), name.to_owned()))
    }

    /// All that charts observe: the chart's name, the name that its expressions use, the channel.
    pub(super) fn all_observed(&self) -> impl Iterator<Item = (&str, &str, &ObservedChannel)> {
        self.observed.iter().map(|((chart, name), channel)| (chart.as_str(), name.as_str(), channel))
    }

    /// The names of the channels that a chart's expressions see.
    pub(super) fn names(&self, chart: &str) -> Vec<&str> {
        let own = self.all_observed().filter(|(of, ..)| *of == chart).map(|(_, name, _)| name);
        own.chain(self.shared.names()).collect()
    }

    /// The type of a channel that a chart's expressions see.
    pub(super) fn ty(&self, chart: &str, name: &str) -> Option<&Type> {
        let own = self.observed(chart, name).map(|observed| &observed.described.ty);
        own.or_else(|| self.shared.get(name))
    }
}

impl Library {
    /// As [`Self::channels`], with what a chart observes of memory: the channels that its expressions see.
    #[must_use]
    pub fn channels_of(&self, chart: &Chart, known: &ChannelSchema) -> ChannelSchema {
        let mut schema = self.channels(known);
        for written in &chart.observed {
            observed(written, known).into_iter().for_each(|(_, channel)| schema.add(channel.described));
        }
        schema
    }

    /// The channels of the program, `known`, and those that the charts declare. A name that is declared twice stands for what
    /// it stands for first; the check finds it.
    #[must_use]
    pub fn channels(&self, known: &ChannelSchema) -> ChannelSchema {
        channels(self, known).0.shared
    }
}

/// The channels of a pattern, by the names that expressions use.
fn observed(written: &WrittenPattern, known: &ChannelSchema) -> [(String, ObservedChannel); 2] {
    let pattern = &written.pattern;
    let fields = known.segment(&pattern.segment).map(|segment| {
        let mut fields = segment.attributes.clone();
        fields.retain(|field| field.name != "confidence" && field.name != "id");
        let has = |name: &str| fields.iter().any(|field| field.name == name);
        if has("pose") && !has("position") {
            fields.push(Parameter::new("position", Type::Vector, "that of the pose, m"));
        }
        fields.push(Parameter::new("confidence", Type::FLOAT, "0 to 1"));
        fields.push(Parameter::new("id", Type::String, "its address in memory"));
        fields
    });
    let channel = |all: bool| {
        let declared = written.name.text.clone();
        let name = if all { format!("{declared}{ALL}") } else { declared.clone() };
        let what = if all { "all matches of" } else { "the match with the highest confidence of" };
        let described = ChannelDescription::new(&name, &format!("Memory: {what} `{pattern}`."));
        let one = match fields.clone() {
            Some(fields) => described.clone().with_fields(fields),
            None => described.clone(),
        };
        let described = if all { ChannelDescription { ty: Type::list(one.ty), ..described } } else { one };
        let described = ChannelDescription { rate: "each change in memory".into(), ..described };
        (name, ObservedChannel { declared, pattern: pattern.clone(), all, described })
    };
    [channel(false), channel(true)]
}

/// The channels that charts know, and what is wrong with how they are declared.
pub(super) fn channels(library: &Library, known: &ChannelSchema) -> (KnownChannels, Vec<Finding>) {
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
    let mut channels = KnownChannels { shared: schema, observed: BTreeMap::new() };
    for chart in library.charts.values() {
        let (own, mut findings) = observed_by(chart, known, &channels.shared);
        channels.observed.extend(own.into_iter().map(|(name, of)| ((chart.name.clone(), name), of)));
        found.append(&mut findings);
    }
    (channels, found)
}

/// What a chart observes, and what is wrong with its names and segments.
fn observed_by(
    chart: &Chart,
    known: &ChannelSchema,
    shared: &ChannelSchema,
) -> (BTreeMap<String, ObservedChannel>, Vec<Finding>) {
    let mut findings = Findings::new(Arc::clone(&chart.source));
    let mut own: BTreeMap<String, ObservedChannel> = BTreeMap::new();
    for written in &chart.observed {
        segment(written, known, &mut findings);
        let channels = observed(written, known);
        let taken = channels.iter().find_map(|(name, _)| match own.get(name) {
            Some(other) => Some((name, format!("it belongs to `{}`", other.declared))),
            None => shared.get(name).map(|_| (name, "observers or skills publish it".to_owned())),
        });
        if let Some((name, by)) = taken {
            let message = format!("there is a channel `{name}` already: {by}");
            let help =
                format!("choose another name; each is also that of a list of all matches: `NAME{ALL}`");
            findings.error_help(code::DUPLICATE, written.name.span, message, Some(help));
            continue;
        }
        own.extend(channels);
    }
    (own, findings.list)
}

/// Warns of a core segment that is probably misspelt. Memory takes any name; those that it knows have attributes with types.
fn segment(written: &WrittenPattern, known: &ChannelSchema, findings: &mut Findings) {
    let segment = written.pattern.segment.as_str();
    let names = known.segments().map(|segment| segment.name.as_str());
    if segment.contains('*') || known.segment(segment).is_some() {
        return;
    }
    let Some(near) = nearest(segment, names) else { return };
    let message = format!("memory has no core segment `{segment}` unless somebody adds it");
    let help = format!("did you mean `{near}`?");
    let text = findings.source.text.get(written.span.start..written.span.end).unwrap_or("");
    let at = text.find(segment).map(|at| written.span.start + at);
    let span = at.map_or(written.span, |start| Span { start, end: start + segment.len() });
    findings.add(Severity::Warning, code::SUSPICIOUS, span, message, Some(help));
    if at.is_some() {
        findings.remedy(Remedy::replace(span, near));
    }
}

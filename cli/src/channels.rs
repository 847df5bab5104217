//! `armarium channels`: prints the channels that charts can watch: fields, units, rates, who publishes and who reads them; and the
//! core segments of memory that they can observe.

use std::io::{self, Write};
use std::path::PathBuf;

use armarium_host::catalog;
use armarium_runtime::chart::{self, ChannelDescription, MemorySegment, Registry};
use armarium_runtime::skill::{Parameter, SkillManifest};
use serde_json::{Value as Json, json};

use crate::charts::{Charts, missing, within_reach};
use crate::type_json::type_json;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ChannelsArgs {
    /// Folders with charts, besides the current one: what they declare and read is listed, too.
    #[arg(long, value_name = "DIR")]
    pub(crate) charts: Vec<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// A channel and everybody who has to do with it.
struct Listed {
    channel: ChannelDescription,
    /// The charts that declare it, by name.
    declared_by: Vec<String>,
    published_by: Vec<String>,
    read_by: Vec<String>,
}

/// Writes the channels. Returns the exit status: 2 when a folder is not there.
pub(crate) fn run(args: &ChannelsArgs, out: &mut dyn Write) -> io::Result<u8> {
    if let Some(folder) = missing(&args.charts) {
        return writeln!(out, "error: there is no folder `{}`", folder.display()).map(|()| 2);
    }
    let charts = within_reach(&args.charts);
    let (channels, segments) = (listed(&catalog::idle_registry(), &charts), segments(&charts));
    if args.json {
        let list: Vec<_> = channels.iter().map(as_json).chain(segments.iter().map(segment_json)).collect();
        serde_json::to_writer_pretty(&mut *out, &list)?;
        return writeln!(out).map(|()| 0);
    }
    channels.iter().try_for_each(|channel| describe(channel, out))?;
    segments.iter().try_for_each(|segment| describe_segment(segment, out))?;
    Ok(0)
}

/// The core segments of memory, each with the charts that observe it: `AwaitCup as cup`.
fn segments(charts: &Charts) -> Vec<(MemorySegment, Vec<String>)> {
    let by = |segment: &MemorySegment| {
        let observing = charts.read.iter().flat_map(|(chart, _)| {
            let own = chart.observes().filter(|(_, pattern)| pattern.segment == segment.name);
            own.map(|(name, _)| format!("{} as {name}", chart.name)).collect::<Vec<_>>()
        });
        (segment.clone(), observing.collect())
    };
    catalog::channels().segments().map(by).collect()
}

fn describe_segment((segment, by): &(MemorySegment, Vec<String>), out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "{}  (in memory; `observe: {{NAME: \"{0}/*/*\"}}`)", segment.name)?;
    writeln!(out, "    {}", segment.description)?;
    for Parameter { name, ty, description, .. } in &segment.attributes {
        writeln!(out, "    channels.NAME.{name}: {ty}  {description}")?;
    }
    if !by.is_empty() {
        writeln!(out, "    observed by: {}", by.join(", "))?;
    }
    writeln!(out)
}

fn segment_json((segment, by): &(MemorySegment, Vec<String>)) -> Json {
    let attributes: Vec<Json> = segment.attributes.iter().map(field_json).collect();
    json!({
        "kind": "segment",
        "name": segment.name,
        "description": segment.description,
        "type": "record",
        "fields": attributes,
        "observed_by": by,
    })
}

fn field_json(field: &Parameter) -> Json {
    let mut json = type_json(&field.ty);
    (json["name"], json["description"]) = (json!(field.name), json!(field.description));
    json
}

/// The channels that ship, and those that charts declare. Charts that do not belong together may declare one name differently.
fn listed(registry: &Registry, charts: &Charts) -> Vec<Listed> {
    let shipped = catalog::channels();
    let alone = |channel: &ChannelDescription| Listed {
        channel: channel.clone(),
        declared_by: Vec::new(),
        published_by: channel.publishers.clone(),
        read_by: channel.readers.clone(),
    };
    let mut list: Vec<Listed> = shipped.described().map(alone).collect();
    for (chart, _) in &charts.read {
        for channel in chart.channels() {
            let same =
                |known: &&mut Listed| known.channel.name == channel.name && known.channel.ty == channel.ty;
            let declared_by = match list.iter_mut().find(same) {
                Some(known) => &mut known.declared_by,
                None => {
                    list.push(alone(channel));
                    &mut list.last_mut().expect("it was pushed above").declared_by
                }
            };
            declared_by.push(chart.name.clone());
        }
    }
    list.sort_by(|a, b| a.channel.name.cmp(&b.channel.name));
    for (chart, library) in &charts.read {
        let Some(program) = chart::check(library, registry, &shipped).program else { continue };
        let schema = library.channels(&shipped);
        for known in &mut list {
            let name = &known.channel.name;
            if program.channels().contains(name) && schema.get(name) == Some(&known.channel.ty) {
                known.read_by.push(format!("chart {}", chart.name));
            }
        }
    }
    for known in &mut list {
        let of = |uses: fn(&SkillManifest) -> &Vec<String>| {
            let using = registry.manifests().filter(|manifest| uses(manifest).contains(&known.channel.name));
            using.map(|manifest| manifest.name.clone()).collect::<Vec<_>>()
        };
        known.published_by.extend(of(|manifest| &manifest.publishes));
        known.read_by.splice(0..0, of(|manifest| &manifest.reads));
    }
    list
}

fn describe(listed: &Listed, out: &mut dyn Write) -> io::Result<()> {
    let Listed { channel, declared_by, published_by, read_by } = listed;
    write!(out, "{}", channel.name)?;
    if !channel.rate.is_empty() {
        write!(out, "  ({})", channel.rate)?;
    }
    writeln!(out)?;
    if !channel.description.is_empty() {
        writeln!(out, "    {}", channel.description)?;
    }
    if channel.fields.is_empty() {
        writeln!(out, "    channels.{}: {}", channel.name, channel.ty)?;
    }
    for Parameter { name, ty, description, .. } in &channel.fields {
        writeln!(out, "    channels.{}.{name}: {ty}  {description}", channel.name)?;
    }
    for (title, names) in [("declared by", declared_by), ("published by", published_by), ("read by", read_by)]
    {
        if !names.is_empty() {
            writeln!(out, "    {title}: {}", names.join(", "))?;
        }
    }
    writeln!(out)
}

fn as_json(listed: &Listed) -> Json {
    let channel = &listed.channel;
    let mut json = match channel.fields.as_slice() {
        [] => type_json(&channel.ty),
        fields => json!({"type": "record", "fields": fields.iter().map(field_json).collect::<Vec<_>>()}),
    };
    json["kind"] = json!("channel");
    json["name"] = json!(channel.name);
    json["description"] = json!(channel.description);
    json["rate"] = json!(channel.rate);
    json["declared_by"] = json!(listed.declared_by);
    json["published_by"] = json!(listed.published_by);
    json["read_by"] = json!(listed.read_by);
    json
}

//! `armarium skills`: prints the skills and charts that charts can use, with inputs, outputs, outcomes, channels and limbs.

use std::io::{self, Write};
use std::path::PathBuf;

use armarium_host::catalog;
use armarium_runtime::attention::{Attended, Attends};
use armarium_runtime::chart::Chart;
use armarium_runtime::skill::{Parameter, SkillManifest};
use armarium_values::Value;
use serde_json::{Value as Json, json};

use crate::charts::{missing, within_reach};
use crate::console::refuse;
use crate::type_json::type_json;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct SkillsArgs {
    /// Only these skills and charts.
    #[arg(value_name = "NAME")]
    pub(crate) names: Vec<String>,
    /// Folders with charts, besides the current one.
    #[arg(long, value_name = "DIR")]
    pub(crate) charts: Vec<PathBuf>,
    /// The skills of this robot, by its name or its file.
    #[arg(long, value_name = "FILE|NAME")]
    pub(crate) robot: Option<String>,
    /// Print JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// A skill, or a chart seen from outside.
struct Listed<'l> {
    manifest: SkillManifest,
    chart: Option<&'l Chart>,
}

/// Writes the skills, then the charts. Returns the exit status: 2 when a name or a folder is unknown.
pub(crate) fn run(args: &SkillsArgs, out: &mut dyn Write) -> io::Result<u8> {
    if let Some(folder) = missing(&args.charts) {
        return writeln!(out, "error: there is no folder `{}`", folder.display()).map(|()| 2);
    }
    let registry = match args.robot.as_deref().map(catalog::registry_of_robot) {
        None => catalog::idle_registry(),
        Some(Ok(registry)) => registry,
        Some(Err(error)) => return refuse(&error, out),
    };
    let charts = within_reach(&args.charts);
    let skills = registry.manifests().map(|manifest| Listed { manifest: manifest.clone(), chart: None });
    let read = charts.read.iter().map(|(chart, _)| Listed { manifest: chart.manifest(), chart: Some(chart) });
    let mut list: Vec<Listed<'_>> = skills.chain(read).collect();
    if let Some(unknown) = args.names.iter().find(|name| list.iter().all(|l| l.manifest.name != **name)) {
        writeln!(out, "there is no skill or chart `{unknown}`; `armarium skills` lists them")?;
        return Ok(2);
    }
    list.retain(|listed| args.names.is_empty() || args.names.contains(&listed.manifest.name));
    if args.json {
        let list: Vec<Json> = list.iter().map(as_json).collect();
        serde_json::to_writer_pretty(&mut *out, &list)?;
        return writeln!(out).map(|()| 0);
    }
    list.iter().try_for_each(|listed| describe(listed, out))?;
    for file in charts.unreadable.iter().filter(|_| args.names.is_empty()) {
        let file = file.display();
        writeln!(out, "{file} is no chart as it is: `armarium check {file}` says why")?;
    }
    Ok(0)
}

fn as_json(Listed { manifest, chart }: &Listed<'_>) -> Json {
    let parameter = |parameter: &Parameter| {
        let mut json = type_json(&parameter.ty);
        json["name"] = json!(parameter.name);
        json["description"] = json!(parameter.description);
        json["default"] = json!(parameter.default.as_ref().map(Value::to_json));
        (json["minimum"], json["maximum"]) = (json!(parameter.minimum), json!(parameter.maximum));
        json["names"] = json!(parameter.names);
        json
    };
    let outcomes = ["success", "failure"].into_iter().chain(manifest.outcomes.iter().map(String::as_str));
    let mut json = json!({
        "kind": if chart.is_some() { "chart" } else { "skill" },
        "name": manifest.name,
        "description": manifest.description.trim(),
        "inputs": manifest.inputs.iter().map(parameter).collect::<Vec<_>>(),
        "outputs": manifest.outputs.iter().map(parameter).collect::<Vec<_>>(),
        "outcomes": outcomes.collect::<Vec<_>>(),
        "events": manifest.events,
        "reads": manifest.reads,
        "publishes": manifest.publishes,
        "attends": attends(manifest),
        "limbs": manifest.limbs,
        "limbs_by_input": manifest.limbs_by_input,
    });
    if let Some(chart) = chart {
        json["file"] = json!(chart.source.path);
        let observed = chart.observes().map(|(name, pattern)| (name.to_owned(), json!(pattern.to_string())));
        json["observes"] = Json::Object(observed.collect());
        json["takes_events"] = json!(chart.events().map(|(event, _)| event).collect::<Vec<_>>());
    }
    json
}

/// What a skill needs to know the place of, for people.
fn attends(manifest: &SkillManifest) -> Vec<String> {
    let what = |attends: &Attends| match &attends.what {
        Attended::Input(name) => format!("what `{name}` names"),
        Attended::Pattern(pattern) => pattern.clone(),
    };
    manifest.attends.iter().map(what).collect()
}

fn describe(Listed { manifest, chart }: &Listed<'_>, out: &mut dyn Write) -> io::Result<()> {
    match chart {
        Some(chart) => writeln!(out, "{}  (chart, {})", manifest.name, chart.source.path.display())?,
        None => writeln!(out, "{}", manifest.name)?,
    }
    let description = manifest.description.split_whitespace().collect::<Vec<_>>().join(" ");
    if !description.is_empty() {
        writeln!(out, "    {description}")?;
    }
    parameters("takes", &manifest.inputs, out)?;
    parameters("gives", &manifest.outputs, out)?;
    let taken: Vec<String> =
        chart.iter().flat_map(|chart| chart.events()).map(|(event, _)| event.to_owned()).collect();
    let observed: Vec<String> = chart
        .iter()
        .flat_map(|chart| chart.observes())
        .map(|(name, pattern)| format!("{pattern} as {name}"))
        .collect();
    let outcomes =
        ["success", "failure"].map(str::to_owned).into_iter().chain(manifest.outcomes.iter().cloned());
    let commands = manifest.commands();
    let lists = [
        ("outcomes", &outcomes.collect()),
        ("events", &manifest.events),
        ("takes the events", &taken),
        ("observes", &observed),
        ("reads", &manifest.reads),
        ("publishes", &manifest.publishes),
        ("attends to", &attends(manifest)),
        ("commands", &commands),
    ];
    for (title, names) in lists.into_iter().filter(|(_, names)| !names.is_empty()) {
        writeln!(out, "    {title}: {}", names.join(", "))?;
    }
    writeln!(out)
}

fn parameters(title: &str, list: &[Parameter], out: &mut dyn Write) -> io::Result<()> {
    for parameter in list {
        let default = parameter.default.as_ref().map_or_else(String::new, |d| format!(" = {}", d.to_json()));
        writeln!(
            out,
            "    {title} {}: {}{default}  {}",
            parameter.name, parameter.ty, parameter.description
        )?;
    }
    Ok(())
}

//! A chart that is ready to run with a robot: loaded, checked, with its inputs.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use armarium_runtime::channels::Channels;
use armarium_runtime::chart::Registry;
use armarium_runtime::exec::{ExecOptions, Executor, Peers, TraceSink};
use armarium_runtime::program::Program;
use armarium_runtime::skill::Limits;
use armarium_simulator::World;
use armarium_source::suggest;
use armarium_states::Equipment;
use armarium_values::Value;

use crate::catalog;
use crate::console::Console;
use crate::error::HostError;
use crate::names::Names;
use crate::network::AgentNetwork;
use crate::replay::{RunSource, TurnRecorder};
use crate::run_config::RunConfig;
use crate::run_log::RunLogger;

/// How long, in real time, a skill may block the program's thread.
const HANG_TIMEOUT: Duration = Duration::from_secs(10);

/// Converts the given inputs to the types that the chart declares. Inputs that the chart does not have stay text;
/// creating the run refuses them, with a suggestion.
///
/// # Errors
/// [`HostError::Input`] for text that is not a value of the input's type.
pub fn read_inputs(
    given: &[(String, String)],
    program: &Program,
) -> Result<BTreeMap<String, Value>, HostError> {
    let read = |(name, text): &(String, String)| {
        let declared = program.inputs().find(|input| input.name == *name);
        let value = declared.map_or_else(|| Ok(Value::from(text.as_str())), |input| input.ty.read(text));
        let wrong = |why| HostError::Input { name: name.clone(), text: text.clone(), why };
        value.map(|value| (name.clone(), value)).map_err(|error| wrong(error.to_string()))
    };
    given.iter().map(read).collect()
}

/// Refuses names that do not exist, where it is known before the run which do.
fn known_names(
    inputs: &BTreeMap<String, Value>,
    program: &Program,
    registry: &Registry,
    chart: &Path,
) -> Result<(), HostError> {
    for input in program.inputs() {
        let given = inputs.get(&input.name).and_then(Value::as_str).filter(|text| !text.is_empty());
        if let (Some(kind), Some(text)) = (input.names, given)
            && let Err(unknown) = registry.known_name(kind, text, chart)
        {
            let near = suggest(text, unknown.known.iter().map(String::as_str));
            let why = near.map_or_else(|| unknown.to_string(), |near| format!("{unknown}; {near}"));
            return Err(HostError::Input { name: input.name.clone(), text: text.to_owned(), why });
        }
    }
    Ok(())
}

/// The program of a chart without errors, and the skills that it runs with.
pub(crate) async fn load(
    config: &RunConfig,
    equipment: &Equipment,
    world: &World,
    network: &AgentNetwork,
    console: &dyn Console,
) -> Result<(Arc<Program>, Registry), HostError> {
    let given = config.inputs.iter().map(|(name, _)| name.clone()).collect();
    let names = Arc::new(Names::of_run(world, equipment.robot.model(), given));
    let mut registry = catalog::registry(equipment, &config.skills).with_names(names);
    let agents = network.agents.as_ref();
    let checked = catalog::load_connected(&config.chart, &config.charts, &mut registry, agents).await?;
    Ok((catalog::runnable(checked, console)?, registry))
}

/// A chart that is ready to run with a robot. It exchanges events with `peers`; when it is `closed`, nobody sends it any.
pub(crate) fn executor(
    config: &RunConfig,
    program: Arc<Program>,
    (registry, channels): (Registry, &Channels),
    logger: &RunLogger,
    equipment: &Equipment,
    (peers, closed): (Peers, bool),
    console: &Arc<dyn Console>,
) -> Result<Executor, HostError> {
    let robot = Arc::clone(&equipment.robot);
    let inputs = read_inputs(&config.inputs, &program)?;
    known_names(&inputs, &program, &registry, &config.chart)?;
    let options = ExecOptions {
        inputs: inputs.clone(),
        profile: config.profile.clone(),
        limits: Limits::default(),
        sink: Some(recorded(config, inputs, Box::new(logger.clone()))?),
        on_stuck: Some(Box::new(move |state| {
            robot.stop(&format!("the skill of `{state}` does not return"));
        })),
        peers,
        closed,
    };
    let executor = Executor::new(program, registry, channels.clone(), options)?;
    // Robots and skills share one thread here: if a skill blocks it, no report can be written.
    let console = Arc::clone(console);
    if config.live.as_ref().is_some_and(|live| live.control) {
        // Somebody who lets time stand still holds up this thread, too.
        return Ok(executor);
    }
    Ok(executor.hang_after(HANG_TIMEOUT, Some(Box::new(move |state| console.blocked(state)))))
}

/// The sink of a run, with a record if one is requested.
fn recorded(
    config: &RunConfig,
    inputs: BTreeMap<String, Value>,
    sink: Box<dyn TraceSink>,
) -> Result<Box<dyn TraceSink>, HostError> {
    let Some(file) = &config.record else { return Ok(sink) };
    let (chart, charts, profile) = (config.chart.clone(), config.charts.clone(), config.profile.clone());
    let source = RunSource { chart, charts, inputs, profile };
    let recorder = TurnRecorder::begin(file, &source, sink).map_err(|source| HostError::File {
        what: "the record cannot be written:",
        path: file.clone(),
        source,
    })?;
    Ok(Box::new(recorder))
}

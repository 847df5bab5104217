//! The program `armarium`: arguments, printing, exit codes. Each subcommand is a file of its own; this one reads the
//! command line and converts results to the exit status. The work is done in `host`, `experiments` and the other
//! rooms.

mod agent;
mod cameras;
mod changes;
mod channels;
mod charts;
mod check;
mod connection_args;
mod console;
mod described;
mod failure;
mod fmt;
mod graph;
mod image;
mod import;
mod junit;
mod logging;
mod lsp;
mod memory;
mod new;
mod render_findings;
mod replay;
mod reproduce;
mod robot;
mod robot_service;
mod run;
mod schema;
mod send;
mod skills;
mod step;
mod stopped;
mod sweep;
mod test_cases;
mod type_json;
mod view;
mod vision;
mod warnings;
mod world;

use std::io::{self, IsTerminal as _, Write};
use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Robot behaviour as statecharts: check it, run it, look at what happened.
#[derive(Debug, Parser)]
#[command(name = "armarium", version, max_term_width = 100)]
#[command(after_help = "Examples:\n  \
    armarium run statecharts/wiping.yaml                      the wiping scenario in the simulator\n  \
    armarium run statecharts/wiping.yaml --set contact_force=10 --seed 3 --report out\n  \
    armarium run statecharts/wiping.yaml --set motion=wiping  start from the motion of the last run\n  \
    armarium run statecharts/share_scene.yaml                 two agents who share what they see\n  \
    armarium agent --name bob statecharts                     offer charts and skills to other agents\n  \
    armarium check statecharts/*.yaml                         what is wrong, before anything moves\n  \
    armarium step chart.yaml --interactive                    drive a chart by hand, without a robot\n  \
    armarium test statecharts/*.test.yaml                     play the test cases of charts\n  \
    armarium graph statecharts/wiping.yaml -o wiping.svg      draw a chart\n  \
    armarium run statecharts/wiping.yaml --live               watch it in the browser\n  \
    armarium view report/run.mcap                             look at it again\n  \
    armarium new my_robot                                     a chart, a world and a test of your own\n\n\
    Exit status: 0 success, 1 a run that failed, 2 a file or argument that is wrong.")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run a chart in the simulator and leave a report.
    Run(run::RunArgs),
    /// Run a chart with many seeds and inputs: how many runs hold, and the spread of their figures.
    Sweep(sweep::SweepArgs),
    /// Draw the ranges of a world file.
    World(world::WorldArgs),
    /// Offer charts and skills to other agents.
    Agent(agent::AgentArgs),
    /// Run the simulated cameras in a process of their own, for `run --cameras`; without images until a run connects.
    Cameras(cameras::CamerasArgs),
    /// Find all errors in charts, worlds, test cases and prior knowledge.
    Check(check::CheckArgs),
    /// Give files their form: two spaces a level, lines of readable length.
    Fmt(fmt::FmtArgs),
    /// Serve an editor: errors as you type, completion, rename, quick fixes (docs/editors.md).
    Lsp(lsp::LspArgs),
    /// Drive a chart by hand or by a list of events, without a robot, in virtual time.
    Step(step::StepArgs),
    /// Play the test cases of charts in virtual time.
    Test(test_cases::TestArgs),
    /// Feed a recorded run to the engine again and compare.
    Replay(replay::ReplayArgs),
    /// Draw a chart: SVG, PNG, DOT, Mermaid, PlantUML or JSON.
    Graph(graph::GraphArgs),
    /// Convert an SCXML document to a chart.
    Import(import::ImportArgs),
    /// Create a chart, a world and a test to start from.
    New(new::NewArgs),
    /// Print the JSON schema of a kind of file.
    Schema(schema::SchemaArgs),
    /// Reproduce an experiment of the papers: figures as JSON, plots as SVG.
    Reproduce(reproduce::ReproduceArgs),
    /// Read, write, save, export and repair the memory of agents.
    Memory(memory::MemoryArgs),
    /// List, show, record, play and check providers of images.
    Image(image::ImageArgs),
    /// Write, check, show and list the files that describe robots.
    Robot(robot::RobotArgs),
    /// Send an event to a chart that runs at another agent.
    Send(send::SendArgs),
    /// List the channels that charts can watch, with who publishes and who reads them, and what they can observe of memory.
    Channels(channels::ChannelsArgs),
    /// List the skills and charts that charts can use.
    Skills(skills::SkillsArgs),
    /// Show the recording of a run in the browser: play it, step, jump, with the chart, the world and all curves.
    View(view::ViewArgs),
    /// Look for hands, gestures, fingertips and markers in images.
    Vision(vision::VisionArgs),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let mut out = io::stdout();
    let status = match &arguments.command {
        Command::Run(args) => run::run(args, &mut io::stderr()),
        Command::Sweep(args) => sweep::run(args, &mut out),
        Command::World(args) => world::run(args, &mut out),
        Command::Agent(args) => agent::run(args, &mut out),
        Command::Cameras(args) => cameras::run(args, &mut out),
        Command::Check(args) => match lsp::known(&args.worlds) {
            Ok(known) => check::run(args, style(), &known, &mut out),
            Err(findings) => console::show(&findings, &mut out).map(|()| 2),
        },
        Command::Fmt(args) => fmt::run(args, &mut out),
        Command::Lsp(args) => lsp::run(args, &mut io::stderr()),
        Command::Step(args) => step::run(args, &mut out, &mut io::stderr()),
        Command::Test(args) => test_cases::run(args, &mut out),
        Command::Replay(args) => replay::run(args, &mut out),
        Command::Graph(args) => graph::run(args, &mut out),
        Command::Import(args) => import::run(args, &mut out, &mut io::stderr()),
        Command::New(args) => new::run(args, &mut out),
        Command::Schema(args) => schema::run(*args, &mut out),
        Command::Reproduce(args) => reproduce::run(args, &mut out),
        Command::Memory(args) => memory::run(args, &mut out, &mut io::stderr()),
        Command::Image(args) => image::run(args, &mut out, &mut io::stderr()),
        Command::Robot(args) => robot::run(args, &mut out),
        Command::Send(args) => send::run(args, &mut out),
        Command::Channels(args) => channels::run(args, &mut out),
        Command::Skills(args) => skills::run(args, &mut out),
        Command::View(args) => view::run(args, &mut out),
        Command::Vision(args) => vision::run(args, &mut out, &mut io::stderr()),
    };
    let status = match status {
        Ok(status) => status,
        // The reader of the output has closed it, as with `armarium skills | head`.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => 0,
        Err(error) => {
            let _ = writeln!(io::stderr(), "the output cannot be written: {error}");
            1
        }
    };
    ExitCode::from(status)
}

/// The style of findings: with colour on a terminal.
fn style() -> check::Style {
    let colour = io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none();
    check::Style { colour, width: 100 }
}

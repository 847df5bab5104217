//! `armarium robot serve|test|scale`: a guard in a process of its own, its rules checked, its speed changed while it runs.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use armarium_bus::{Access, KeyError, SessionError};
use armarium_host::{Address, Connection, Console, HostError, RobotService};
use armarium_robot::description::Description;
use armarium_robot::driver::{Driver as _, DriverClock, GuardedDriver, RemoteDriver};
use armarium_robot::{Guard, GuardConfig, JointKind, Model, RemoteRobot, Robot, conformance};

use crate::connection_args::{ConnectionArgs, LiveArgs, explained};
use crate::console::Terminal;
use crate::described::described;
use crate::failure::CommandFailure;
use crate::stopped::stopped;

/// By what name this program asks for a robot, unless it is told another one.
const CALLER: &str = "armarium robot";

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct RobotServeArgs {
    /// The driver (`docs/wire-robot.md`); it may come and go.
    #[arg(long, value_name = "AGENT/NAME")]
    driver: Address,
    /// The robot, by its name (`armarium robot list`) or its file.
    #[arg(long, value_name = "FILE|NAME")]
    robot: String,
    /// The name under which others use the robot; that of the driver if not given.
    #[arg(long = "as", value_name = "AGENT/NAME")]
    offered: Option<Address>,
    /// Multiply all commanded velocities; `armarium robot scale` changes it.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    speed_scale: f64,
    /// Do everything but send targets to the driver: nothing moves.
    #[arg(long)]
    dry: bool,
    /// A peer that may see the robot's states; may be repeated. As soon as any peer is named, all others are denied everything.
    #[arg(long = "watcher", value_name = "NAME", requires = "ca")]
    watchers: Vec<String>,
    /// A peer that may lease and command the robot; may be repeated.
    #[arg(long = "commander", value_name = "NAME", requires = "ca")]
    commanders: Vec<String>,
    /// A peer that may offer the driver; may be repeated.
    #[arg(long = "driven-by", value_name = "NAME", requires = "ca")]
    driven_by: Vec<String>,
    #[command(flatten)]
    live: LiveArgs,
    #[command(flatten)]
    connection: ConnectionArgs,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct RobotTestArgs {
    /// The robot behind its guard, or with --driver a driver.
    #[arg(value_name = "AGENT/NAME")]
    at: Address,
    /// It is a driver: the guard is in this process.
    #[arg(long)]
    driver: bool,
    /// The robot, by its name (`armarium robot list`) or its file.
    #[arg(long, value_name = "FILE|NAME")]
    robot: String,
    /// The group or hand to test; may be repeated. All arms if not given.
    #[arg(long, value_name = "NAME")]
    limb: Vec<String>,
    /// Move the robot. Without it, only what will be done is said.
    #[arg(long)]
    moves: bool,
    /// By what name to ask for it; with certificates, the common name of the own one.
    #[arg(long, value_name = "NAME", default_value = CALLER)]
    name: String,
    #[command(flatten)]
    connection: ConnectionArgs,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ScaleArgs {
    /// The robot behind its guard.
    #[arg(value_name = "AGENT/NAME")]
    at: Address,
    /// By what all commanded velocities are multiplied from now on: over 0, at most 1.
    factor: f64,
    /// The robot, by its name (`armarium robot list`) or its file.
    #[arg(long, value_name = "FILE|NAME")]
    robot: String,
    /// By what name to ask for it; with certificates, the common name of the own one.
    #[arg(long, value_name = "NAME", default_value = CALLER)]
    name: String,
    #[command(flatten)]
    connection: ConnectionArgs,
}

/// Serves until Ctrl-C. Returns the exit status.
pub(crate) fn serve(args: &RobotServeArgs) -> Result<u8, CommandFailure> {
    let Description { model, .. } = described(&args.robot, &[])?;
    let offered = args.offered.clone().unwrap_or_else(|| args.driver.clone());
    let access = Access {
        own: offered.agent.clone(),
        watchers: args.watchers.clone(),
        commanders: args.commanders.clone(),
        drivers: args.driven_by.clone(),
        ..Access::default()
    };
    let connection = connect(&args.connection, access.is_for_others().then_some(&access))?;
    let (driver, speed_scale, dry) = (args.driver.clone(), args.speed_scale, args.dry);
    let address = args.live.address(&args.connection).map_err(|error| error.to_string())?;
    let live = Some(address).filter(|_| args.live.live);
    let service = RobotService { driver, offered, model, speed_scale, dry, live };
    let console: Arc<dyn Console> = Arc::new(Terminal::for_notes(false));
    let served = connection.runtime().block_on(async {
        for endpoint in connection.session().endpoints().await {
            console.note(&format!("listens on {endpoint}"));
        }
        tokio::select! {
            biased;
            () = stopped() => Ok(()),
            failed = service.serve(connection.session(), &console) => failed,
        }
    });
    served.map(|()| 0).map_err(CommandFailure::Host)
}

/// Says what will be done, and with `--moves` does it. Returns the exit status: 1 when a rule is broken.
pub(crate) fn test(args: &RobotTestArgs, out: &mut dyn Write) -> Result<u8, CommandFailure> {
    let Description { model, .. } = described(&args.robot, &[])?;
    let limbs: Vec<String> = match args.limb.as_slice() {
        [] => model.arms().map(|arm| arm.name.clone()).collect(),
        named => named.to_vec(),
    };
    if let Some(strange) = limbs.iter().find(|limb| model.find_limb(limb).is_none()) {
        let known = model.limbs().keys().map(String::as_str).collect::<Vec<_>>().join(", ");
        return Err(format!("the robot has no group or hand `{strange}`; it has {known}").into());
    }
    explain(&model, &limbs, out)?;
    if !args.moves {
        writeln!(out, "Nothing was moved. With --moves this is done.")?;
        return Ok(0);
    }
    let connection = connect(&args.connection, None)?;
    let status = check(args, &connection, &model, &limbs, out).map_err(CommandFailure::Host)?;
    Ok(status?)
}

/// What somebody has to know who lets the robot move.
fn explain(model: &Model, limbs: &[String], out: &mut dyn Write) -> io::Result<()> {
    let config = GuardConfig::of(model);
    writeln!(out, "The robot `{}` will move, each limb for about half a minute:", model.name())?;
    for limb in limbs {
        writeln!(out, "  {limb}")?;
        for joint in model.limb(limb).iter().map(|&joint| &model.joints()[joint]) {
            let unit = if joint.kind == JointKind::Prismatic { "m" } else { "rad" };
            let (name, speed) = (&joint.name, joint.velocity);
            writeln!(
                out,
                "    {name}: up to {speed} {unit}/s, away from its nearer limit, for tenths of a second"
            )?;
        }
    }
    writeln!(
        out,
        "Commands stop, are nonsense, and come from two at once: it has to stand within 0.2 s each time."
    )?;
    let (force, watchdog) = (config.force_n, config.watchdog.as_millis());
    writeln!(out, "The guard gives way at {force} N and brakes after {watchdog} ms without a command.")?;
    writeln!(out, "Keep everybody and everything out of reach, and a hand on the emergency stop.")
}

/// Checks the limbs: with a driver in lockstep in virtual time, where the machine's load does not count.
fn check(
    args: &RobotTestArgs,
    connection: &Connection,
    model: &Arc<Model>,
    limbs: &[String],
    out: &mut dyn Write,
) -> Result<io::Result<u8>, HostError> {
    let (session, threads) = (connection.session(), connection.runtime());
    let at = (args.at.agent.as_str(), args.at.name.as_str());
    if !args.driver {
        let robot: Arc<dyn Robot> =
            Arc::new(threads.block_on(RemoteRobot::connect(session, at, model, &args.name))?);
        return Ok(threads.block_on(judge(&robot, limbs, out)));
    }
    let driver = threads.block_on(RemoteDriver::connect(session, at, model, &args.name))?;
    let clock = driver.clock();
    let (guard, robot) = Guard::new(Arc::clone(model), GuardConfig::of(model));
    let robot: Arc<dyn Robot> = robot;
    let ends = Arc::new(AtomicBool::new(false));
    let ended = Arc::clone(&ends);
    let judged = async {
        let guarding =
            tokio::spawn(GuardedDriver::new(guard, driver).run(move |_, _| !ended.load(Ordering::Relaxed)));
        let judged = judge(&robot, limbs, out).await;
        // The driver brakes and is given back. If it was lost, the judgement says so.
        ends.store(true, Ordering::Relaxed);
        let _ = guarding.await;
        judged
    };
    match clock {
        DriverClock::Realtime => Ok(threads.block_on(judged)),
        DriverClock::Lockstep => {
            let mut builder = tokio::runtime::Builder::new_current_thread();
            Ok(builder.enable_all().start_paused(true).build()?.block_on(judged))
        }
    }
}

async fn judge(robot: &Arc<dyn Robot>, limbs: &[String], out: &mut dyn Write) -> io::Result<u8> {
    let mut status = 0;
    for limb in limbs {
        match conformance::check(robot, limb).await {
            Ok(()) => writeln!(out, "{limb}: keeps every rule")?,
            Err(violation) => {
                status = 1;
                writeln!(out, "{limb}: {violation}")?;
            }
        }
    }
    robot.stop("the test has ended");
    robot.reset();
    Ok(status)
}

/// Sets the speed scale of a robot. Returns the exit status.
pub(crate) fn scale(args: &ScaleArgs, out: &mut dyn Write) -> Result<u8, CommandFailure> {
    let Description { model, .. } = described(&args.robot, &[])?;
    let connection = connect(&args.connection, None)?;
    let Address { agent, name } = &args.at;
    let robot = RemoteRobot::connect(connection.session(), (agent, name), &model, &args.name);
    let set = connection.runtime().block_on(robot).and_then(|robot| robot.set_speed_scale(args.factor));
    set.map_err(|error| CommandFailure::Host(error.into()))?;
    writeln!(out, "{agent}/{name} moves at {} of what is commanded", args.factor)?;
    Ok(0)
}

fn connect(args: &ConnectionArgs, access: Option<&Access>) -> Result<Connection, String> {
    let no_name = |error: KeyError| SessionError::Config { what: error.to_string() };
    let mut config = args.config().map_err(|error| explained(&error))?;
    config.access_control =
        access.map(Access::rules).transpose().map_err(|error| explained(&no_name(error)))?;
    Connection::open(&config).map_err(|error| error.to_string())
}

//! The configuration of a run.

use std::path::PathBuf;
use std::time::Duration;

use armarium_bus::SessionConfig;
use armarium_runtime::chart;
use armarium_simulator::World;
use armarium_viewer::live::PageAddress;
use armarium_visionx::HandDetection;

use crate::catalog::SkillFactory;
use crate::driven::RobotAt;

/// The page of a run.
#[derive(Clone, Debug, Default)]
pub struct LiveOptions {
    /// Where it is served.
    pub address: PageAddress,
    /// Whether the page may act.
    pub control: bool,
}

/// The configuration of a run.
#[derive(Clone)]
pub struct RunConfig {
    /// The chart.
    pub chart: PathBuf,
    /// Additional folders in which charts find other charts by name.
    pub charts: Vec<PathBuf>,
    /// The simulated world; `None`: `NAME.world.yaml` beside the chart `NAME.yaml`, or else the default kitchen.
    pub world: Option<PathBuf>,
    /// The robot, by its name or its file, instead of the world's.
    pub robot: Option<String>,
    /// Seed of all random variation.
    pub seed: u64,
    /// How people's hands are found.
    pub hands: HandDetection,
    /// Inputs of the chart as text: `("patience", "30s")`.
    pub inputs: Vec<(String, String)>,
    /// The chart's profile whose defaults are used.
    pub profile: Option<String>,
    /// Folder for `report.json`, `report.html` and `run.mcap`.
    pub report: PathBuf,
    /// Whether a folder that holds a report, or that another run writes to, is left alone, and the first of `DIR-2`, `DIR-3`
    /// ... that is free is used.
    pub keep_reports: bool,
    /// The long-term store of motions.
    pub store: PathBuf,
    /// Core segments, besides `Motions`, that are kept in it and known again at the start, such as `EnvironmentModels`.
    pub remember: Vec<String>,
    /// The record of the engine's turns, for [`replay`](crate::replay::Replay).
    pub record: Option<PathBuf>,
    /// Whether time is real. With other agents it always is.
    pub real_time: bool,
    /// The name by which other agents can send events to this run.
    pub name: Option<String>,
    /// The name of cameras in another process, which show the same world with the same seed.
    pub cameras: Option<String>,
    /// The robot in place of the simulated one. The world then only says what the agent knows. With a driver in lockstep, and
    /// without other agents, cameras or a name, time is virtual.
    pub robot_at: Option<RobotAt>,
    /// By what all commanded velocities are multiplied.
    pub speed_scale: Option<f64>,
    /// How other agents are reached; if they are needed and this is `None`, on this machine.
    pub session: Option<SessionConfig>,
    /// The program `armarium`, which starts the world's other agents; without it they must be running.
    pub program: Option<PathBuf>,
    /// Additional skills.
    pub skills: Vec<SkillFactory>,
    /// The longest time of the robot after which the run is stopped.
    pub longest: Option<Duration>,
    /// The most bytes that the recording may have.
    pub largest_recording: Option<u64>,
    /// The page that shows the run while it goes on.
    pub live: Option<LiveOptions>,
    /// The port of this machine on which Foxglove finds the topics of the recording, 0 for any that is free.
    pub foxglove_port: Option<u16>,
}

impl RunConfig {
    /// A run of the chart in virtual time, which writes `report/` and `armarium.redb`.
    pub fn new(chart: impl Into<PathBuf>) -> Self {
        Self {
            chart: chart.into(),
            charts: Vec::new(),
            world: None,
            robot: None,
            seed: 1,
            hands: HandDetection::default(),
            inputs: Vec::new(),
            profile: None,
            report: "report".into(),
            keep_reports: false,
            store: "armarium.redb".into(),
            remember: Vec::new(),
            record: None,
            real_time: false,
            name: None,
            cameras: None,
            robot_at: None,
            speed_scale: None,
            session: None,
            program: None,
            skills: Vec::new(),
            longest: None,
            largest_recording: None,
            live: None,
            foxglove_port: None,
        }
    }

    /// What the chart says of the world that it runs in: the arm that its input `arm` names, empty if none, and its probes.
    pub(crate) fn wants(&self) -> (String, Vec<String>) {
        const ARM: &str = "arm";
        let library = chart::load(&self.chart, &self.charts);
        let root = library.charts.get(&library.root);
        let given = self.inputs.iter().find(|(name, _)| name == ARM).map(|(_, arm)| arm.clone());
        let usual = || root.and_then(|chart| chart.usual_text(ARM, self.profile.as_deref()));
        let probes = root.map_or_else(Vec::new, |chart| chart.probes().map(str::to_owned).collect());
        (given.or_else(usual).unwrap_or_default(), probes)
    }

    /// How other agents are reached, if at all.
    pub(crate) fn session(&self, world: &World, named: bool) -> Option<SessionConfig> {
        let sees_or_shows_images = self.cameras.is_some() || !world.agents.is_empty();
        if self.session.is_none() && !named && !sees_or_shows_images && self.robot_at.is_none() {
            return None;
        }
        let session = self.session.clone().unwrap_or_default();
        Some(SessionConfig { shared_memory: session.shared_memory || sees_or_shows_images, ..session })
    }
}

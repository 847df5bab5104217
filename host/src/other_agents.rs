//! The other agents of a simulated world: offers them their cameras' images, starts and ends their processes with the
//! run, and shares memory with them in both directions.
//!
//! All of this runs on the session's threads, in real time, beside the run.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::Session;
use armarium_knowledge::{AgentMemory, FollowedAgent, Followee, ServedMemory, agent_pose_update};
use armarium_memoryx::{Memory, RemoteMemory, WorkingMemory};
use armarium_robot::description;
use armarium_runtime::exec::Controller;
use armarium_simulator::world::AgentSpec;
use armarium_simulator::{Handle, World};
use armarium_values::report::Picture;
use armarium_visionx::ImageSource;
use armarium_visionx::providers::{Offered, StereoProvider, offer};
use nalgebra::Isometry3;
use parking_lot::Mutex;
use tokio::task::JoinSet;
use tokio::time::Instant;

use crate::connection::is_there;
use crate::error::HostError;
use crate::frame_sampler::FrameSampler;
use crate::memory_log::{self, LoggedChange, MemoryLog};
use crate::recording::{SharedRecorder, world_text};

/// How long to wait until an agent's memory answers.
const MEMORY_TIMEOUT: Duration = Duration::from_secs(60);
const END_TIMEOUT: Duration = Duration::from_secs(5);
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// What is shared, and with which agents.
pub(crate) struct Sharing {
    pub(crate) session: Session,
    pub(crate) world: World,
    /// The world file, beside which the other agents' charts are.
    pub(crate) world_file: PathBuf,
    pub(crate) memory: Arc<AgentMemory>,
    /// The images of the other agents, by agent name.
    pub(crate) eyes: Vec<(String, Arc<dyn ImageSource>)>,
    /// The folder for the other agents' logs.
    pub(crate) folder: PathBuf,
    /// The program `armarium`, which starts absent agents.
    pub(crate) program: Option<PathBuf>,
    pub(crate) clock: Handle,
}

impl Sharing {
    /// Writes the world as it is in this run, from which the other agents read the same one.
    fn write_world(&self) -> Result<PathBuf, HostError> {
        let mut world = self.world.clone();
        if description::is_file(&world.robot.model)
            && let Ok(absolute) = std::path::absolute(&world.robot.model)
        {
            world.robot.model = absolute.to_string_lossy().into_owned();
        }
        let path = self.folder.join("world.json");
        let failed = |error| {
            HostError::OtherAgent(format!("the world cannot be written to {}: {error}", path.display()))
        };
        std::fs::write(&path, world_text(&world)).map_err(failed)?;
        Ok(path)
    }
}

/// What remains after they have ended: the log of the memories, and some of the other agents' images.
#[derive(Default)]
pub(crate) struct OtherAgentsRecord {
    pub(crate) memory_log: Vec<LoggedChange>,
    eyes: Vec<(String, Arc<FrameSampler>)>,
}

impl OtherAgentsRecord {
    /// Some of the other agents' images; `states_at` names the robot's states at that time.
    pub(crate) fn pictures(&self, states_at: &dyn Fn(u64) -> String) -> Vec<Picture> {
        let of = |(name, eyes): &(String, Arc<FrameSampler>)| {
            eyes.pictures(&|t_ns| format!("the eyes of {name}, in its own frame · {}", states_at(t_ns)))
        };
        self.eyes.iter().flat_map(of).collect()
    }
}

/// The other agents, until this is dropped.
pub(crate) struct OtherAgents {
    processes: Arc<Mutex<Vec<Process>>>,
    memory_log: MemoryLog,
    eyes: Vec<(String, Arc<FrameSampler>)>,
    _followed: Vec<FollowedAgent>,
    _offered: Vec<Offered>,
    _served: ServedMemory,
    _tasks: JoinSet<()>,
}

impl OtherAgents {
    /// Shares the robot's memory, offers the other agents their images, starts the absent agents, and follows all of
    /// them.
    pub(crate) async fn start(sharing: Sharing) -> Result<Self, HostError> {
        let Sharing { session, world, memory, clock, .. } = &sharing;
        let own = &world.robot.name;
        memory.memory().commit_now(vec![agent_pose_update(own, &Isometry3::identity())?])?;
        let served = memory.share(session).await?;
        let frame = world.model()?.camera_frame().to_owned();
        let (mut offered, mut samplers) = (Vec::new(), Vec::new());
        for (agent, eyes) in &sharing.eyes {
            let sampler = Arc::new(FrameSampler::of(Arc::clone(eyes), world, SharedRecorder::default()));
            let shown: Arc<dyn ImageSource> = Arc::<FrameSampler>::clone(&sampler);
            let provider = Arc::new(StereoProvider::new(shown, &format!("{agent}/{frame}")));
            offered.push(offer(session, own, provider).await?);
            samplers.push((agent.clone(), sampler));
        }
        let processes = Arc::new(Mutex::new(Vec::new()));
        for agent in &world.agents {
            if !is_there(session, &agent.name).await? {
                let process = Process::start(agent, &sharing).await?;
                processes.lock().push(process);
            }
        }
        let memory_log = MemoryLog::default();
        let mut tasks = JoinSet::new();
        let known: Arc<dyn Memory> = Arc::<WorkingMemory>::clone(memory.memory());
        tasks.spawn(memory_log::keep(own.clone(), known, clock.clone(), Arc::clone(&memory_log)));
        let mut followed = Vec::new();
        for agent in &world.agents {
            let other = follow_started(&sharing, &agent.name, &processes).await?;
            let remote: Arc<dyn Memory> = Arc::<RemoteMemory>::clone(&other.remote);
            tasks.spawn(memory_log::keep(agent.name.clone(), remote, clock.clone(), Arc::clone(&memory_log)));
            followed.push(other);
        }
        Ok(Self {
            processes,
            memory_log,
            eyes: samplers,
            _followed: followed,
            _offered: offered,
            _served: served,
            _tasks: tasks,
        })
    }

    /// Stops a run when one of the started processes ends.
    pub(crate) fn watch(&self, run: Controller) -> impl Future<Output = ()> + use<> {
        let processes = Arc::clone(&self.processes);
        async move {
            loop {
                if let Some(lost) = processes.lock().iter_mut().find_map(Process::ended) {
                    return run.stop(lost);
                }
                tokio::time::sleep(POLL_INTERVAL).await;
            }
        }
    }

    /// Ends the started processes; returns what remains.
    pub(crate) async fn close(self) -> OtherAgentsRecord {
        let processes = std::mem::take(&mut *self.processes.lock());
        for mut process in processes {
            process.end().await;
        }
        OtherAgentsRecord { memory_log: std::mem::take(&mut *self.memory_log.lock()), eyes: self.eyes }
    }
}

/// Follows an agent that may still be starting.
async fn follow_started(
    sharing: &Sharing,
    agent: &str,
    processes: &Mutex<Vec<Process>>,
) -> Result<FollowedAgent, HostError> {
    let deadline = Instant::now() + MEMORY_TIMEOUT;
    loop {
        let error = match sharing.memory.follow(&sharing.session, &Followee::of(agent)).await {
            Ok(followed) => return Ok(followed),
            Err(error) => error,
        };
        if let Some(lost) = processes.lock().iter_mut().find_map(Process::ended) {
            return Err(HostError::OtherAgent(lost));
        }
        if Instant::now() > deadline {
            return Err(error.into());
        }
        tokio::time::sleep(POLL_INTERVAL).await;
    }
}

/// An agent's process. It ends when its standard input closes, so that it never outlives this process.
struct Process {
    agent: String,
    child: Child,
    input: Option<ChildStdin>,
    log: PathBuf,
}

impl Process {
    async fn start(agent: &AgentSpec, sharing: &Sharing) -> Result<Self, HostError> {
        let (name, robot) = (&agent.name, &sharing.world.robot.name);
        let endpoints = sharing.session.endpoints().await;
        let listens_nowhere = || HostError::OtherAgent("this process listens nowhere: give --listen".into());
        let endpoint = endpoints.first().ok_or_else(listens_nowhere)?;
        let world_file = sharing.write_world()?;
        let world = world_file.display();
        let (Some(chart), Some(program)) = (&agent.runs, &sharing.program) else {
            return Err(HostError::OtherAgent(format!(
                "the agent `{name}` is not there; start it with: armarium agent --name {name} --world {world} \
                 --eyes {robot}/{name} --follow {robot} --run CHART --connect {endpoint}"
            )));
        };
        let chart = sharing.world_file.parent().unwrap_or(Path::new("")).join(chart);
        let log = sharing.folder.join(format!("{name}.log"));
        let failed = |what: &str, error: std::io::Error| {
            HostError::OtherAgent(format!("the agent `{name}` cannot be started: {what}: {error}"))
        };
        let written = File::create(&log).map_err(|e| failed(&log.display().to_string(), e))?;
        let said = written.try_clone().map_err(|e| failed("its log", e))?;
        let mut child = Command::new(program)
            .args(["agent", "--name", name, "--eyes", &format!("{robot}/{name}")])
            .args(["--follow", robot, "--connect", endpoint, "--while-input", "--verbose"])
            .arg("--world")
            .arg(&world_file)
            .arg("--run")
            .arg(&chart)
            .arg("--store")
            .arg(sharing.folder.join(format!("{name}.redb")))
            .stdin(Stdio::piped())
            .stdout(written)
            .stderr(said)
            .spawn()
            .map_err(|e| failed(&program.display().to_string(), e))?;
        let input = child.stdin.take();
        Ok(Self { agent: name.clone(), child, input, log })
    }

    /// A message when the process has ended by itself.
    fn ended(&mut self) -> Option<String> {
        let status = self.child.try_wait().ok().flatten()?;
        let said = std::fs::read_to_string(&self.log).unwrap_or_default();
        let last = said.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("nothing");
        let (agent, log) = (&self.agent, self.log.display());
        Some(format!("the agent `{agent}` has ended ({status}); the last it said in {log}: {last}"))
    }

    /// Asks the process to end, and kills it after a timeout.
    async fn end(&mut self) {
        drop(self.input.take());
        let deadline = Instant::now() + END_TIMEOUT;
        while Instant::now() < deadline {
            if !matches!(self.child.try_wait(), Ok(None)) {
                return;
            }
            tokio::time::sleep(POLL_INTERVAL).await;
        }
        tracing::warn!(
            "the agent `{}` did not end within {} s and was killed",
            self.agent,
            END_TIMEOUT.as_secs()
        );
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            // It may just be ending by itself; wait, so that no zombie is left.
            let _ = self.child.kill().and_then(|()| self.child.wait()).is_ok();
        }
    }
}

//! The other agents of a simulated world: their eyes are offered to them, their processes started and ended with the run,
//! and memory is shared with them both ways.
//!
//! Everything here runs on the threads of the session, in real time, beside the run.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::Session;
use armarium_memoryx::{
    FollowedAgent, FollowingAgent, LongTermMemory, Memory, MemoryServer, RemoteMemory, WorkingMemory,
    agent_stands,
};
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
use crate::memory_log::{self, Entry, MemoryLog};
use crate::recording::SharedRecorder;

/// How long an agent may take until its memory answers.
const PATIENCE: Duration = Duration::from_secs(60);
/// How long an agent may take to end.
const GRACE: Duration = Duration::from_secs(5);
/// How often it is looked whether a process still runs.
const LOOK: Duration = Duration::from_millis(100);

/// What is shared, and with whom.
pub(crate) struct Invitation {
    pub(crate) session: Session,
    pub(crate) world: World,
    /// The world's file, from which the others read the same world.
    pub(crate) world_file: PathBuf,
    pub(crate) memory: Arc<WorkingMemory>,
    pub(crate) store: Arc<LongTermMemory>,
    /// What the others see, by their names.
    pub(crate) eyes: Vec<(String, Arc<dyn ImageSource>)>,
    /// Where the others' logs go.
    pub(crate) folder: PathBuf,
    /// The program `armarium`, which starts those who are not there yet.
    pub(crate) program: Option<PathBuf>,
    pub(crate) clock: Handle,
}

/// What is left when they have gone: what the memories came to know, and some of what the others saw.
#[derive(Default)]
pub(crate) struct CompanyRecord {
    pub(crate) memory_log: Vec<Entry>,
    eyes: Vec<(String, Arc<FrameSampler>)>,
}

impl CompanyRecord {
    /// Some of the others' images; `states_at` names what the robot did then.
    pub(crate) fn pictures(&self, states_at: &dyn Fn(u64) -> String) -> Vec<Picture> {
        let of = |(name, eyes): &(String, Arc<FrameSampler>)| {
            eyes.pictures(&|t_ns| format!("the eyes of {name}, in its own frame · {}", states_at(t_ns)))
        };
        self.eyes.iter().flat_map(of).collect()
    }
}

/// The other agents, for as long as this lives.
pub(crate) struct Company {
    processes: Arc<Mutex<Vec<Process>>>,
    memory_log: MemoryLog,
    eyes: Vec<(String, Arc<FrameSampler>)>,
    _followed: Vec<FollowedAgent>,
    _offered: Vec<Offered>,
    _server: MemoryServer,
    _tasks: JoinSet<()>,
}

impl Company {
    /// Shares the robot's memory, offers the others their eyes, starts those who are not there yet, and
    /// follows all of them.
    ///
    /// # Errors
    /// [`HostError::OtherAgent`] when one is not there and cannot be started; [`HostError::Memory`] and
    /// [`HostError::Session`] when nothing can be shared.
    pub(crate) async fn gather(invitation: Invitation) -> Result<Self, HostError> {
        let Invitation { session, world, memory, clock, .. } = &invitation;
        let own = &world.robot.name;
        memory.commit_now(vec![agent_stands(own, &Isometry3::identity())?])?;
        let store = Some(Arc::clone(&invitation.store));
        let server = MemoryServer::start_with(session, own, Arc::clone(memory), store).await?;
        let (mut offered, mut samplers) = (Vec::new(), Vec::new());
        for (agent, eyes) in &invitation.eyes {
            let sampler = Arc::new(FrameSampler::of(Arc::clone(eyes), world, SharedRecorder::default()));
            let shown: Arc<dyn ImageSource> = Arc::<FrameSampler>::clone(&sampler);
            let provider = Arc::new(StereoProvider::new(shown, &format!("{agent}/camera_left")));
            offered.push(offer(session, own, provider).await?);
            samplers.push((agent.clone(), sampler));
        }
        let processes = Arc::new(Mutex::new(Vec::new()));
        for agent in &world.agents {
            if !is_there(session, &agent.name).await? {
                let process = Process::start(agent, &invitation).await?;
                processes.lock().push(process);
            }
        }
        let memory_log = MemoryLog::default();
        let mut tasks = JoinSet::new();
        let shared: Arc<dyn Memory> = Arc::<WorkingMemory>::clone(memory);
        tasks.spawn(memory_log::keep(own.clone(), shared, clock.clone(), Arc::clone(&memory_log)));
        let mut followed = Vec::new();
        for agent in &world.agents {
            let other = follow_started(&invitation, &agent.name, &processes).await?;
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
            _server: server,
            _tasks: tasks,
        })
    }

    /// Stops a run when one of the processes that were started for it ends.
    pub(crate) fn watch(&self, run: Controller) -> impl Future<Output = ()> + use<> {
        let processes = Arc::clone(&self.processes);
        async move {
            loop {
                if let Some(lost) = processes.lock().iter_mut().find_map(Process::ended) {
                    return run.stop(lost);
                }
                tokio::time::sleep(LOOK).await;
            }
        }
    }

    /// Ends the processes that were started; gives what is left.
    pub(crate) async fn close(self) -> CompanyRecord {
        let processes = std::mem::take(&mut *self.processes.lock());
        for mut process in processes {
            process.end().await;
        }
        CompanyRecord { memory_log: std::mem::take(&mut *self.memory_log.lock()), eyes: self.eyes }
    }
}

/// Follows an agent who may just be starting.
async fn follow_started(
    invitation: &Invitation,
    agent: &str,
    processes: &Mutex<Vec<Process>>,
) -> Result<FollowedAgent, HostError> {
    let deadline = Instant::now() + PATIENCE;
    let following = FollowingAgent {
        session: invitation.session.clone(),
        memory: Arc::clone(&invitation.memory),
        own: invitation.world.robot.name.clone(),
    };
    loop {
        let error = match following.follow(&agent.into()).await {
            Ok(followed) => return Ok(followed),
            Err(error) => error,
        };
        if let Some(lost) = processes.lock().iter_mut().find_map(Process::ended) {
            return Err(HostError::OtherAgent(lost));
        }
        if Instant::now() > deadline {
            return Err(error.into());
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// An agent's process, which ends when its standard input does, so that it never outlives this one.
struct Process {
    agent: String,
    child: Child,
    input: Option<ChildStdin>,
    log: PathBuf,
}

impl Process {
    async fn start(agent: &AgentSpec, invitation: &Invitation) -> Result<Self, HostError> {
        let (name, robot) = (&agent.name, &invitation.world.robot.name);
        let endpoints = invitation.session.endpoints().await;
        let listens_nowhere = || HostError::OtherAgent("this process listens nowhere: give --listen".into());
        let endpoint = endpoints.first().ok_or_else(listens_nowhere)?;
        let world = invitation.world_file.display();
        let (Some(chart), Some(program)) = (&agent.runs, &invitation.program) else {
            return Err(HostError::OtherAgent(format!(
                "the agent `{name}` is not there; start it with: armarium agent --name {name} --world {world} \
                 --eyes {robot}/{name} --follow {robot} --run CHART --connect {endpoint}"
            )));
        };
        let chart = invitation.world_file.parent().unwrap_or(Path::new("")).join(chart);
        let log = invitation.folder.join(format!("{name}.log"));
        let failed = |what: &str, error: std::io::Error| {
            HostError::OtherAgent(format!("the agent `{name}` cannot be started: {what}: {error}"))
        };
        let written = File::create(&log).map_err(|e| failed(&log.display().to_string(), e))?;
        let said = written.try_clone().map_err(|e| failed("its log", e))?;
        let mut child = Command::new(program)
            .args(["agent", "--name", name, "--eyes", &format!("{robot}/{name}")])
            .args(["--follow", robot, "--connect", endpoint, "--while-input", "--verbose"])
            .arg("--world")
            .arg(&invitation.world_file)
            .arg("--run")
            .arg(&chart)
            .arg("--store")
            .arg(invitation.folder.join(format!("{name}.redb")))
            .stdin(Stdio::piped())
            .stdout(written)
            .stderr(said)
            .spawn()
            .map_err(|e| failed(&program.display().to_string(), e))?;
        let input = child.stdin.take();
        Ok(Self { agent: name.clone(), child, input, log })
    }

    /// What is to be said when it has ended by itself.
    fn ended(&mut self) -> Option<String> {
        let status = self.child.try_wait().ok().flatten()?;
        let said = std::fs::read_to_string(&self.log).unwrap_or_default();
        let last = said.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("nothing");
        let (agent, log) = (&self.agent, self.log.display());
        Some(format!("the agent `{agent}` has ended ({status}); the last it said in {log}: {last}"))
    }

    /// Asks it to end, and makes it when it does not.
    async fn end(&mut self) {
        drop(self.input.take());
        let deadline = Instant::now() + GRACE;
        while Instant::now() < deadline {
            if !matches!(self.child.try_wait(), Ok(None)) {
                return;
            }
            tokio::time::sleep(LOOK).await;
        }
        tracing::warn!("the agent `{}` did not end within {} s and was killed", self.agent, GRACE.as_secs());
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            // It may end at this very moment; it is waited for so that nothing of it is left.
            let _ = self.child.kill().and_then(|()| self.child.wait()).is_ok();
        }
    }
}

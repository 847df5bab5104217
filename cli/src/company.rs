//! The other agents of a simulated world: their eyes are offered to them, their processes started and ended with the run,
//! and memory is shared with them both ways.
//!
//! Everything here runs on the threads of the session, in real time, beside the run.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use armarium_bus::Session;
use armarium_memoryx::{LongTermMemory, Memory, MemoryServer, RemoteMemory, WorkingMemory};
use armarium_runtime::exec::Controller;
use armarium_simulator::world::AgentSpec;
use armarium_simulator::{Handle, World};
use armarium_viewer::report::Picture;
use armarium_visionx::ImageSource;
use armarium_visionx::providers::{Offered, StereoProvider, offer};
use nalgebra::Isometry3;
use tokio::task::JoinSet;
use tokio::time::Instant;

use crate::connection::is_there;
use crate::following::{Followed, follow, stands};
use crate::gallery::Gallery;
use crate::memories::{self, Diary, Entry};
use crate::recording::{SharedRecorder, locked};

/// How long an agent may take until its memory answers.
const PATIENCE: Duration = Duration::from_secs(60);
/// How long an agent may take to end.
const GRACE: Duration = Duration::from_secs(5);
/// How often it is looked whether a process still runs.
const LOOK: Duration = Duration::from_millis(100);

/// What is shared, and with whom.
pub(crate) struct Beginning {
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
    pub(crate) clock: Handle,
}

/// What is left when they have gone: what the memories came to know, and some of what the others saw.
#[derive(Default)]
pub(crate) struct Told {
    pub(crate) diary: Vec<Entry>,
    eyes: Vec<(String, Arc<Gallery>)>,
}

impl Told {
    /// Some of the others' images; `states_at` names what the robot did then.
    pub(crate) fn pictures(&self, states_at: &dyn Fn(u64) -> String) -> Vec<Picture> {
        let of = |(name, eyes): &(String, Arc<Gallery>)| {
            eyes.pictures(&|t_ns| format!("the eyes of {name}, in its own frame · {}", states_at(t_ns)))
        };
        self.eyes.iter().flat_map(of).collect()
    }
}

/// The other agents, for as long as this lives.
pub(crate) struct Company {
    processes: Arc<Mutex<Vec<Process>>>,
    diary: Diary,
    eyes: Vec<(String, Arc<Gallery>)>,
    _followed: Vec<Followed>,
    _offered: Vec<Offered>,
    _server: MemoryServer,
    _tasks: JoinSet<()>,
}

impl Company {
    /// Shares the robot's memory, offers the others their eyes, starts those who are not there yet, and
    /// follows all of them.
    ///
    /// # Errors
    /// One sentence for people.
    pub(crate) async fn gather(beginning: Beginning) -> Result<Self, String> {
        let Beginning { session, world, memory, clock, .. } = &beginning;
        let own = &world.robot.name;
        let stand = stands(own, &Isometry3::identity()).and_then(|stand| memory.commit_now(vec![stand]));
        stand.map_err(|e| e.to_string())?;
        let store = Some(Arc::clone(&beginning.store));
        let server = MemoryServer::start_with(session, own, Arc::clone(memory), store).await;
        let server = server.map_err(|e| e.to_string())?;
        let (mut offered, mut galleries) = (Vec::new(), Vec::new());
        for (agent, eyes) in &beginning.eyes {
            let gallery = Arc::new(Gallery::of(Arc::clone(eyes), world, SharedRecorder::default()));
            let shown: Arc<dyn ImageSource> = Arc::<Gallery>::clone(&gallery);
            let provider = Arc::new(StereoProvider::new(shown, &format!("{agent}/camera_left")));
            offered.push(offer(session, own, provider).await.map_err(|e| e.to_string())?);
            galleries.push((agent.clone(), gallery));
        }
        let processes = Arc::new(Mutex::new(Vec::new()));
        for agent in &world.agents {
            if !is_there(session, &agent.name).await.map_err(|e| e.to_string())? {
                let process = Process::start(agent, &beginning).await?;
                locked(&processes).push(process);
            }
        }
        let diary = Diary::default();
        let mut tasks = JoinSet::new();
        let shared: Arc<dyn Memory> = Arc::<WorkingMemory>::clone(memory);
        tasks.spawn(memories::keep(own.clone(), shared, clock.clone(), Arc::clone(&diary)));
        let mut followed = Vec::new();
        for agent in &world.agents {
            let other = follow_started(&beginning, &agent.name, &processes).await?;
            let remote: Arc<dyn Memory> = Arc::<RemoteMemory>::clone(&other.remote);
            tasks.spawn(memories::keep(agent.name.clone(), remote, clock.clone(), Arc::clone(&diary)));
            followed.push(other);
        }
        Ok(Self {
            processes,
            diary,
            eyes: galleries,
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
                if let Some(lost) = locked(&processes).iter_mut().find_map(Process::ended) {
                    return run.stop(lost);
                }
                tokio::time::sleep(LOOK).await;
            }
        }
    }

    /// Ends the processes that were started; gives what is left.
    pub(crate) async fn close(self) -> Told {
        let processes = std::mem::take(&mut *locked(&self.processes));
        for mut process in processes {
            process.end().await;
        }
        Told { diary: std::mem::take(&mut *locked(&self.diary)), eyes: self.eyes }
    }
}

/// Follows an agent who may just be starting.
async fn follow_started(
    beginning: &Beginning,
    agent: &str,
    processes: &Mutex<Vec<Process>>,
) -> Result<Followed, String> {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let own = &beginning.world.robot.name;
        let error = match follow(&beginning.session, &beginning.memory, own, agent).await {
            Ok(followed) => return Ok(followed),
            Err(error) => error,
        };
        if let Some(lost) = locked(processes).iter_mut().find_map(Process::ended) {
            return Err(lost);
        }
        if Instant::now() > deadline {
            return Err(error);
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
    async fn start(agent: &AgentSpec, beginning: &Beginning) -> Result<Self, String> {
        let (name, robot) = (&agent.name, &beginning.world.robot.name);
        let endpoints = beginning.session.endpoints().await;
        let endpoint = endpoints.first().ok_or("this process listens nowhere: give --listen")?;
        let world = beginning.world_file.display();
        let Some(chart) = &agent.runs else {
            return Err(format!(
                "the agent `{name}` is not there; start it with: armarium agent --name {name} --world {world} \
                 --eyes {robot}/{name} --follow {robot} --run CHART --connect {endpoint}"
            ));
        };
        let chart = beginning.world_file.parent().unwrap_or(Path::new("")).join(chart);
        let log = beginning.folder.join(format!("{name}.log"));
        let failed = |what: &str, error: std::io::Error| {
            format!("the agent `{name}` cannot be started: {what}: {error}")
        };
        let written = File::create(&log).map_err(|e| failed(&log.display().to_string(), e))?;
        let said = written.try_clone().map_err(|e| failed("its log", e))?;
        let program = std::env::current_exe().map_err(|e| failed("this program's file", e))?;
        let mut child = Command::new(&program)
            .args(["agent", "--name", name, "--eyes", &format!("{robot}/{name}")])
            .args(["--follow", robot, "--connect", endpoint, "--while-input", "--verbose"])
            .arg("--world")
            .arg(&beginning.world_file)
            .arg("--run")
            .arg(&chart)
            .arg("--store")
            .arg(beginning.folder.join(format!("{name}.redb")))
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

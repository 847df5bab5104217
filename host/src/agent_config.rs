//! What an agent is started with.

use std::path::PathBuf;

use armarium_bus::{Access, SessionConfig};
use armarium_knowledge::Followee;
use armarium_memoryx::{Policies, Retention};
use armarium_viewer::live::PageAddress;
use armarium_visionx::HandDetection;

use crate::address::Address;
use crate::catalog::SkillFactory;
use crate::simulated::usual_policies;

/// The configuration of an agent.
#[derive(Clone)]
pub struct AgentConfig {
    /// The name by which other agents call it.
    pub name: String,
    /// Charts to offer, or folders of charts. Skills are always offered.
    pub offered: Vec<PathBuf>,
    /// Additional folders in which charts find other charts by name.
    pub charts: Vec<PathBuf>,
    /// A chart that the agent runs from the start; the agent ends with it.
    pub run: Option<PathBuf>,
    /// The simulated world of the agent; `None`: the default kitchen.
    pub world: Option<PathBuf>,
    /// Seed of all random variation in the world.
    pub seed: u64,
    /// How people's hands are found.
    pub hands: HandDetection,
    /// Images of another agent, used as the agent's eyes. The agent then has no robot, only skills that move nothing,
    /// and its pose is the one in the world file.
    pub eyes: Option<Address>,
    /// Agents whose memory is followed as soon as they are available.
    pub follow: Vec<Followee>,
    /// The file of long-term memory.
    pub store: PathBuf,
    /// What the file keeps of memory.
    pub policies: Policies,
    /// How much the file keeps.
    pub retention: Retention,
    /// How other agents are reached.
    pub session: SessionConfig,
    /// The peers that it admits; `None` admits all, with all rights.
    pub access: Option<Access>,
    /// Additional skills.
    pub skills: Vec<SkillFactory>,
    /// Where its live page is served; `None` serves none.
    pub live: Option<PageAddress>,
}

impl AgentConfig {
    /// An agent with a simulated robot in the default kitchen, reachable on this machine only.
    pub fn new(name: &str) -> Self {
        Self {
            name: name.into(),
            offered: Vec::new(),
            charts: Vec::new(),
            run: None,
            world: None,
            seed: 1,
            hands: HandDetection::default(),
            eyes: None,
            follow: Vec::new(),
            store: "armarium-agent.redb".into(),
            policies: usual_policies(),
            retention: Retention::default(),
            session: SessionConfig::default(),
            access: None,
            skills: Vec::new(),
            live: None,
        }
    }
}

//! The sections of other agents' eyes and of boards in the view.

use super::super::{AgentSpec, CoverSpec, World};
use super::values::{Reader, Unit};
use crate::world::agents::default_rate;
use crate::world::tree::Node;

/// What is nearer than this is not looked at, m.
const NEAREST_LOOK: f64 = 0.1;

impl Reader<'_> {
    pub(super) fn agent(&mut self, node: &Node, others: &[AgentSpec], world: &World) -> AgentSpec {
        let mut agent = AgentSpec {
            name: String::new(),
            at: [0.0, 1.4, 1.5],
            looks_at: [world.table.center[0], world.table.center[1], world.table.height],
            rate: default_rate(),
            runs: None,
        };
        let Some(s) = self.section(node, &["name", "at", "looks_at", "rate", "runs"]) else { return agent };
        self.text(s.get("name"), &mut agent.name);
        self.agent_name(s.get("name").unwrap_or(node), &agent.name);
        if agent.name == world.robot.name || others.iter().any(|other| other.name == agent.name) {
            let message = format!("two agents are named `{}`", agent.name);
            let help = "the robot is an agent too: `robot: {name: ..}`".into();
            self.find(s.get("name").unwrap_or(node).referenced, "world::value", message, help);
        }
        self.vector(s.get("at"), &mut agent.at, Unit::Metre, -5.0..=5.0);
        self.vector(s.get("looks_at"), &mut agent.looks_at, Unit::Metre, -5.0..=5.0);
        let squared: f64 = agent.at.iter().zip(agent.looks_at).map(|(a, b)| (a - b).powi(2)).sum();
        if squared.sqrt() < NEAREST_LOOK {
            let message = format!("`{}` looks at a point in its own eyes", agent.name);
            let at = s.get("looks_at").unwrap_or(node).referenced;
            self.find(at, "world::value", message, "move `at` or `looks_at`".into());
        }
        self.number(s.get("rate"), &mut agent.rate, Unit::Hertz, 1.0..=120.0);
        if let Some(chart) = s.get("runs") {
            self.text(Some(chart), agent.runs.get_or_insert_default());
        }
        agent
    }

    /// Names of agents are parts of network keys.
    pub(super) fn agent_name(&mut self, node: &Node, name: &str) {
        let usual = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        if name.is_empty() || !name.chars().all(usual) {
            let message = format!("`{name}` cannot be an agent's name");
            let help = "letters, digits, `_` and `-`".into();
            self.find(node.referenced, "world::value", message, help);
        }
    }

    pub(super) fn cover(&mut self, node: &Node) -> CoverSpec {
        let mut cover = CoverSpec::default();
        let Some(s) = self.section(node, &["at", "size", "yaw_deg", "yaw", "color"]) else { return cover };
        self.vector(s.get("at"), &mut cover.at, Unit::Metre, -5.0..=5.0);
        self.vector(s.get("size"), &mut cover.size, Unit::Metre, 0.001..=3.0);
        self.number(s.get("yaw_deg"), &mut cover.yaw_deg, Unit::Degree, -360.0..=360.0);
        if let Some(rad) = s.get("yaw").and_then(|n| self.scalar(n, Unit::Radian, &(-6.3..=6.3))) {
            cover.yaw_deg = rad.to_degrees();
        }
        self.color(s.get("color"), &mut cover.color);
        cover
    }
}

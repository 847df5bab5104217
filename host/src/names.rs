//! The names that exist before a run: the robot's postures and arms, and the classes of objects that prior knowledge has.

use std::collections::BTreeSet;
use std::path::Path;

use armarium_robot::Model;
use armarium_runtime::chart::KnownNames;
use armarium_runtime::skill::NameKind;
use armarium_simulator::World;
use armarium_simulator::world::PROBES;
use armarium_source::{Disk, Files as _, outermost};

use crate::simulated::prior_knowledge;

/// The names of a run, of a chart that is only checked, or of an agent.
#[derive(Debug, Default)]
pub(crate) struct Names {
    postures: BTreeSet<String>,
    arms: BTreeSet<String>,
    classes: Classes,
    /// The inputs that a run is given.
    given: BTreeSet<String>,
}

/// Where object classes come from.
#[derive(Debug, Default)]
enum Classes {
    /// A run: prior knowledge of its world.
    Run(BTreeSet<String>),
    /// A chart that is only checked: it may run in the default world, in these, and in those beside its file.
    Check(BTreeSet<String>),
    /// An agent: others may tell it of classes while it runs.
    #[default]
    Agent,
}

impl Names {
    pub(crate) fn of_run(world: &World, robot: &Model, given: BTreeSet<String>) -> Self {
        Self { given, classes: Classes::Run(classes(world)), ..Self::of_agent(robot) }
    }

    pub(crate) fn of_check(worlds: &[World]) -> Self {
        let (mut all, mut known) = (Self::default(), BTreeSet::new());
        for world in std::iter::once(&World::default()).chain(worlds) {
            known.extend(classes(world));
            if let Ok(robot) = world.model() {
                all.postures.extend(postures(&robot));
                all.arms.extend(arms(&robot));
            }
        }
        Self { classes: Classes::Check(known), ..all }
    }

    pub(crate) fn of_agent(robot: &Model) -> Self {
        Self { postures: postures(robot), arms: arms(robot), ..Self::default() }
    }
}

impl KnownNames for Names {
    fn names(&self, kind: NameKind, chart: &Path) -> Option<BTreeSet<String>> {
        match (kind, &self.classes) {
            (NameKind::Posture, _) => Some(self.postures.clone()),
            (NameKind::Arm, _) => Some(self.arms.clone()),
            (NameKind::Probe, _) => Some(PROBES.map(str::to_owned).into()),
            (NameKind::ObjectClass, Classes::Run(known)) => Some(known.clone()),
            (NameKind::ObjectClass, Classes::Check(known)) => {
                let mut known = known.clone();
                known.extend(beside(chart));
                Some(known)
            }
            _ => None,
        }
    }

    fn is_given(&self, input: &str) -> bool {
        self.given.contains(input)
    }
}

fn arms(robot: &Model) -> BTreeSet<String> {
    robot.arms().map(|arm| arm.name.clone()).collect()
}

fn postures(robot: &Model) -> BTreeSet<String> {
    robot.postures().keys().cloned().collect()
}

/// The classes of objects of which a robot in this world has prior knowledge.
fn classes(world: &World) -> BTreeSet<String> {
    let prior = prior_knowledge(world);
    prior.iter().flat_map(|prior| prior.classes()).map(|class| class.name.clone()).collect()
}

/// The classes of the worlds beside a chart, and those that are files of their own there.
fn beside(chart: &Path) -> BTreeSet<String> {
    let mut known = BTreeSet::new();
    for file in Disk.list(chart.parent().unwrap_or(Path::new(""))) {
        let head = Disk.head(&file).unwrap_or_default();
        if let Some(name) = outermost(&head, "object") {
            known.insert(name.to_owned());
        } else if outermost(&head, "world").is_some()
            && let Ok(world) = World::load(&file, 1)
        {
            known.extend(classes(&world));
        }
    }
    known
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn object_classes_come_from_the_world_of_the_run_or_from_the_files_beside_the_chart() {
        let folder = tempfile::tempdir().unwrap();
        let chart = folder.path().join("fetch.yaml");
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        write("kitchen.world.yaml", "world: kitchen\nobjects: [{name: cup}]\n");
        write("plate.yaml", "object: plate   # from the cupboard\ncolor: [1, 2, 3]\nsize: [0.1, 0.1, 0.1]\n");
        write("broken.yaml", "world: broken\nobjects: [\n");
        let has = |names: &Names, class: &str| {
            names.names(NameKind::ObjectClass, &chart).is_some_and(|known| known.contains(class))
        };
        let check = Names::of_check(&[]);
        for class in ["sponge", "coach_tool", "cup", "plate"] {
            assert!(has(&check, class), "{class}");
        }
        assert!(!has(&check, "fork"));
        let elsewhere = World::parse(Path::new("w"), "world: w\nobjects: [{name: fork}]\n").unwrap();
        assert!(has(&Names::of_check(std::slice::from_ref(&elsewhere)), "fork"));
        let robot = elsewhere.model().unwrap();
        let run = Names::of_run(&elsewhere, &robot, BTreeSet::from(["object".to_owned()]));
        assert!(run.is_given("object") && !run.is_given("place"));
        assert!(has(&run, "fork") && has(&run, "sponge") && !has(&run, "cup"));
        assert_eq!(Names::of_agent(&robot).names(NameKind::ObjectClass, &chart), None);
        assert!(Names::of_agent(&robot).names(NameKind::Posture, &chart).unwrap().contains("home"));
    }
}

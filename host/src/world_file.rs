//! Selects the world of a chart: the given one, else the one beside the chart, else the default kitchen.

use std::path::{Path, PathBuf};

use armarium_simulator::{SimulationError, World};
use armarium_source::Finding;

/// A world and its file.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldFile {
    /// The world.
    pub world: World,
    /// `None` for the default kitchen.
    pub file: Option<PathBuf>,
}

impl WorldFile {
    /// The world of `given`, else of `NAME.world.yaml` beside the chart `NAME.yaml` if there is one. Values of its ranges are
    /// drawn by `seed`.
    ///
    /// # Errors
    /// Everything that is wrong with the file.
    pub fn of(chart: &Path, given: Option<&Path>, seed: u64) -> Result<Self, Vec<Finding>> {
        let beside = Some(chart.with_extension("world.yaml")).filter(|file| file.is_file());
        let file = given.map(Path::to_owned).or(beside);
        let world = file.as_deref().map_or_else(|| Ok(World::default()), |file| World::load(file, seed))?;
        Ok(Self { world, file })
    }

    /// The world in which an arm works. A world that names no arm is laid out for the robot's first, and is mirrored for one
    /// on the other side. A file that was `given` stays as it is.
    ///
    /// # Errors
    /// [`SimulationError::Robot`] when its robot cannot be read.
    pub fn for_arm(self, arm: &str, given: bool) -> Result<Self, SimulationError> {
        let Self { mut world, file } = self;
        if world.robot.arm.is_none() && !arm.is_empty() {
            let model = world.model()?;
            if given {
                world.robot.arm = model.arm(arm).map(|limb| limb.name.clone());
            } else {
                world = world.for_arm(&model, arm);
            }
        }
        Ok(Self { world, file })
    }

    /// The arm that the world names, if the chart works with another.
    ///
    /// # Errors
    /// [`SimulationError::Robot`] when its robot cannot be read.
    pub fn other_than(&self, arm: &str) -> Result<Option<String>, SimulationError> {
        let model = self.world.model()?;
        let works = self.world.robot.arm(&model).map(|limb| limb.name.clone());
        let is_there = model.arms().any(|limb| limb.name == arm);
        Ok(works.filter(|works| is_there && works != arm))
    }

    /// The name by which other agents address the run: the requested one, else the robot's if the world has other
    /// agents. Then both are the same.
    pub fn called(&mut self, asked: Option<&str>) -> Option<String> {
        if self.world.agents.is_empty() {
            return asked.map(str::to_owned);
        }
        if let Some(name) = asked {
            name.clone_into(&mut self.world.robot.name);
        }
        Some(self.world.robot.name.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_world_beside_the_chart_is_used_unless_another_is_given() {
        let folder = tempfile::tempdir().unwrap();
        let chart = folder.path().join("dance.yaml");
        assert_eq!(WorldFile::of(&chart, None, 1), Ok(WorldFile { world: World::default(), file: None }));
        let beside = folder.path().join("dance.world.yaml");
        std::fs::write(&beside, "world: hall\n").unwrap();
        let scene = WorldFile::of(&chart, None, 1).unwrap();
        assert_eq!((scene.world.name.as_str(), scene.file), ("hall", Some(beside)));
        let given = folder.path().join("street.yaml");
        std::fs::write(&given, "world: street\n").unwrap();
        assert_eq!(WorldFile::of(&chart, Some(&given), 1).unwrap().world.name, "street");
        assert!(WorldFile::of(&chart, Some(&folder.path().join("none.yaml")), 1).is_err());
    }

    #[test]
    fn a_world_is_mirrored_for_an_arm_of_the_other_side_and_one_that_was_given_is_not() {
        let kitchen = || WorldFile { world: World::default(), file: None };
        let model = kitchen().world.model().unwrap();
        let arm = |side: f64| model.arms().find(|arm| model.side_of(arm) == side).unwrap().name.clone();
        let of = |scene: WorldFile, arm: &str| scene.for_arm(arm, false).unwrap().world;
        let (first, other) = (arm(1.0), arm(-1.0));
        let table = |world: &World| world.table.center[0];
        assert_eq!(of(kitchen(), ""), World::default());
        assert_eq!(of(kitchen(), "nose"), World::default());
        assert_eq!(table(&of(kitchen(), &first)), table(&World::default()));
        let mirrored = of(kitchen(), &other);
        assert_eq!(table(&mirrored), -table(&World::default()));
        assert_eq!(
            (mirrored.robot.arm.as_deref(), mirrored.name.as_str()),
            (Some(&*other), "kitchen_mirrored")
        );
        let file = || WorldFile { file: Some(PathBuf::from("w.yaml")), ..kitchen() };
        assert_eq!(table(&of(file(), &other)), -table(&World::default()), "one beside the chart");
        let laid_out = file().for_arm(&other, true).unwrap().world;
        assert_eq!(
            (laid_out.robot.arm.as_deref(), table(&laid_out)),
            (Some(&*other), table(&World::default()))
        );
        let mut own = file();
        own.world.robot.arm = Some(first.clone());
        assert_eq!(own.other_than(&other).unwrap(), Some(first.clone()));
        assert_eq!(own.other_than("nose").unwrap(), None);
        assert_eq!(of(own, &other).robot.arm, Some(first));
    }

    #[test]
    fn a_run_has_a_name_where_it_needs_one() {
        let mut kitchen = WorldFile { world: World::default(), file: None };
        assert_eq!((kitchen.called(None), kitchen.called(Some("bob"))), (None, Some("bob".into())));
        assert_eq!(kitchen.world.robot.name, "local");
        let text = "robot: {name: bob}\nagents: [{name: alice}]\n";
        let world = World::parse(Path::new("w"), text).unwrap();
        let mut two = WorldFile { world, file: None };
        assert_eq!(two.called(None).as_deref(), Some("bob"));
        assert_eq!(two.called(Some("carl")).as_deref(), Some("carl"));
        assert_eq!(two.world.robot.name, "carl");
    }
}

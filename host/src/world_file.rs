//! Selects the world of a chart: the given one, else the one beside the chart, else the default kitchen.

use std::path::{Path, PathBuf};

use armarium_simulator::World;
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
    /// The world of `given`, else of `NAME.world.yaml` beside the chart `NAME.yaml` if there is one.
    ///
    /// # Errors
    /// Everything that is wrong with the file.
    pub fn of(chart: &Path, given: Option<&Path>) -> Result<Self, Vec<Finding>> {
        let beside = Some(chart.with_extension("world.yaml")).filter(|file| file.is_file());
        let file = given.map(Path::to_owned).or(beside);
        let world = file.as_deref().map_or_else(|| Ok(World::default()), World::load)?;
        Ok(Self { world, file })
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
        assert_eq!(WorldFile::of(&chart, None), Ok(WorldFile { world: World::default(), file: None }));
        let beside = folder.path().join("dance.world.yaml");
        std::fs::write(&beside, "world: hall\n").unwrap();
        let scene = WorldFile::of(&chart, None).unwrap();
        assert_eq!((scene.world.name.as_str(), scene.file), ("hall", Some(beside)));
        let given = folder.path().join("street.yaml");
        std::fs::write(&given, "world: street\n").unwrap();
        assert_eq!(WorldFile::of(&chart, Some(&given)).unwrap().world.name, "street");
        assert!(WorldFile::of(&chart, Some(&folder.path().join("none.yaml"))).is_err());
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

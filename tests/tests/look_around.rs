//! What stands around the robot: known where it is, once, not where it was, and still the next day.

use std::path::Path;
use std::sync::Arc;

use armarium_host::simulated::memory_of_run;
use armarium_host::{Console, RunConfig, RunEnded, Silent, run};
use armarium_simulator::World;

const PLACES: &str = "EnvironmentModels";

fn looked_around(folder: &Path, rounds: &str) -> RunEnded {
    let charts = armarium_tests::repository::root().join("statecharts");
    let config = RunConfig {
        report: folder.join(format!("report_{rounds}")),
        store: folder.join("memory.redb"),
        remember: vec![PLACES.to_owned()],
        inputs: vec![("rounds".to_owned(), rounds.to_owned())],
        ..RunConfig::new(charts.join("look_around.yaml"))
    };
    let console: Arc<dyn Console> = Arc::new(Silent);
    run(&config, &console).unwrap()
}

#[test]
fn furniture_is_known_where_it_is_and_still_the_next_day() {
    let folder = tempfile::tempdir().unwrap();
    let ended = looked_around(folder.path(), "3");
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let own = &ended.report["environment"];
    let missed: Vec<_> = ended.figures.iter().filter(|figure| figure.passed() == Some(false)).collect();
    assert!(missed.is_empty(), "{missed:?} {own}");
    assert_eq!(own["tops"].as_array().map(Vec::len), Some(4), "{own}");
    assert_eq!(own["moved"][0]["name"], "trolley", "{own}");
    assert_eq!(own["bulks"][0]["missed"], 0, "{own}");
    // What the store holds is what the next run begins with.
    let charts = armarium_tests::repository::root().join("statecharts");
    let world = World::load(&charts.join("look_around.world.yaml"), 1).unwrap();
    let memory = memory_of_run(&world, &folder.path().join("memory.redb"), &[PLACES.to_owned()]).unwrap();
    let table = memory.memory().latest_now(&format!("{PLACES}/local/table").parse().unwrap()).unwrap();
    assert!(table.instance().unwrap().confidence > 0.9);
    let bush = memory.memory().latest_now(&format!("{PLACES}/local/bulk").parse().unwrap()).unwrap();
    assert!(
        bush.attribute("size").unwrap().as_vector3().unwrap().iter().all(|edge| *edge >= 0.2),
        "{bush:?}"
    );
    drop(memory);
    // The next day the trolley is back: where it was remembered, it is no longer.
    let ended = looked_around(folder.path(), "1");
    let own = &ended.report["environment"];
    for wrong in ["twice", "invented", "bulk_invented"] {
        assert_eq!(own[wrong], 0, "{own}");
    }
    assert_eq!(own["tops"][0]["known_as"], "table", "{own}");
}

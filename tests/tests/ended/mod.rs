//! Runs a chart for a test, with report and memory in a folder that goes with it.

use std::sync::Arc;

use armarium_host::{Console, RunConfig, RunEnded, Silent, run};

/// How a run ended.
pub(crate) fn ended(config: RunConfig) -> RunEnded {
    let folder = tempfile::tempdir().expect("there is a temporary folder");
    let config = RunConfig {
        report: folder.path().join("report"),
        store: folder.path().join("memory.redb"),
        ..config
    };
    let console: Arc<dyn Console> = Arc::new(Silent);
    run(&config, &console).expect("the run begins")
}

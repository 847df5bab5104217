//! The Python examples of `docs/wire-memory.md`, run against an agent.
//!
//! They need a Python with `eclipse-zenoh` and `cbor2`; the variable `ARMARIUM_PYTHON` names its program. Without it
//! this test prints that it did not run them.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use armarium_bus::{Session, SessionConfig};
use armarium_knowledge::{AgentMemory, MemoryConfig};

use crate::outside::not_run;

/// The Python blocks of the page, joined.
fn examples(page: &str) -> String {
    let mut code = String::new();
    let mut inside = false;
    for line in page.lines() {
        match line {
            "```python" => inside = true,
            "```" => inside = false,
            line if inside => {
                code.push_str(line);
                code.push('\n');
            }
            _ => {}
        }
    }
    code
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_examples_run() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/wire-memory.md");
    let code = examples(&std::fs::read_to_string(page).unwrap());
    assert!(code.contains("def conclude()"), "the page has its examples");
    let Some(python) = std::env::var_os("ARMARIUM_PYTHON") else {
        return not_run("ARMARIUM_PYTHON names no Python with the packages eclipse-zenoh and cbor2");
    };
    let folder = tempfile::tempdir().unwrap();
    let session = Session::open(&SessionConfig::default()).await.unwrap();
    let config = MemoryConfig::new("alice").with_store(folder.path().join("alice.redb"));
    let clock = session.clone();
    let agent = AgentMemory::open(config, Arc::new(move || clock.now_ns())).unwrap();
    let _served = agent.share(&session).await.unwrap();
    let endpoint = session.endpoints().await.remove(0);
    let run = move || Command::new(python).args(["-c", &code, &endpoint]).output();
    let output = tokio::task::spawn_blocking(run).await.unwrap().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && text.contains("all examples ran"), "{text}\n{errors}");
    assert!(agent.store().unwrap().verify().unwrap().is_intact());
}

//! A run is the same on every machine: also where the C library takes its functions for a processor that offers less. On a system
//! without the GNU C library the two runs are only two runs.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

fn trace(chart: &str, time: &str, tunables: &str, folder: &Path) -> Value {
    let charts = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../statecharts");
    let mut run = Command::new(env!("CARGO_BIN_EXE_armarium"));
    run.current_dir(folder).arg("run").arg(charts.join(chart)).args(["--for", time]);
    let output = run.env("GLIBC_TUNABLES", tunables).output().expect("it runs");
    let text = std::fs::read_to_string(folder.join("report/report.json")).unwrap_or_default();
    assert!(!text.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_str(&text).expect("it is JSON");
    report["trace_sha256"].clone()
}

#[test]
fn a_trace_is_the_same_whatever_the_processor_offers() {
    for (chart, time) in
        [("wiping.yaml", "10s"), ("learn_together.yaml", "8s"), ("segment_by_pushing.yaml", "10s")]
    {
        let [this, lesser] = ["", "glibc.cpu.hwcaps=-AVX512F,-AVX2,-AVX,-FMA,-FMA4"].map(|tunables| {
            let folder = tempfile::tempdir().expect("a temporary folder");
            trace(chart, time, tunables, folder.path())
        });
        assert!(this.is_string(), "{chart} has a trace");
        assert_eq!(this, lesser, "{chart}");
    }
}

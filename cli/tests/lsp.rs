//! The language server, spoken to by a client that is not ours: `pytest-lsp`, in `editor/tests/client`.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::outside::not_run;

/// A Python with the package `pytest-lsp`, where there is one.
fn python() -> Option<std::ffi::OsString> {
    std::env::var_os("ARMARIUM_PYTHON").filter(|program| {
        let tried = Command::new(program).args(["-c", "import pytest_lsp"]).stderr(Stdio::null()).status();
        tried.is_ok_and(|status| status.success())
    })
}

#[test]
fn another_client_is_served() {
    let Some(python) = python() else {
        return not_run("ARMARIUM_PYTHON names no Python with the package pytest-lsp");
    };
    let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("../editor/tests/client");
    let output = Command::new(python)
        .args(["-m", "pytest", "-q", "-p", "no:cacheprovider"])
        .arg(tests)
        .env("ARMARIUM", env!("CARGO_BIN_EXE_armarium"))
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .expect("Python can be started");
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
}

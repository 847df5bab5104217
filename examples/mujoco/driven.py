"""A run of a chart with the driver of `drive.py`, each in a process of its own."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROBOT = HERE.parent.parent / "robots" / "armar3" / "robot.yaml"
TIMEOUT_S = 900.0  # of the whole run


def free_endpoint() -> str:
    with socket.socket() as tried:
        tried.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{tried.getsockname()[1]}"


def run(armarium: Path, drive: list[str | Path], chart: Path, options: list[str | Path]) -> tuple[str, str]:
    """Runs a chart to its success. Returns what the run and the driver said."""
    endpoint = free_endpoint()
    command: list[str | Path] = [sys.executable, HERE / "drive.py", ROBOT, "--listen", endpoint, *drive]
    driver = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert driver.stdout is not None
        if "is ready" not in driver.stdout.readline():
            raise SystemExit("the driver cannot be started")
        command = [armarium.resolve(), "run", chart, "--driver", "mujoco/armar3", "--connect", endpoint, *options]
        ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=TIMEOUT_S)
    finally:
        driver.terminate()
        said, _ = driver.communicate()
    if ended.returncode != 0:
        raise SystemExit(f"the run failed: {ended.stdout[-2000:]}\n{ended.stderr[-2000:]}")
    return ended.stdout + ended.stderr, said

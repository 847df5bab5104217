"""Wipes in MuJoCo, and judges the forces as they truly were: the driver, `armarium run`, and their figures.

    python examples/mujoco/wipe.py target/release/armarium --store armarium.redb

The store has to have a motion `wiping`; `armarium run statecharts/wiping.yaml` leaves one there.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from pathlib import Path

import numpy as np
from driven import HERE, run

FORCE_N, RMS_N, LOST_N = 8.0, 1.5, 0.2  # what is wanted, how far off it may be, and what counts as lost contact


def wipe(armarium: Path, store: Path, folder: Path, around: list[str]) -> tuple[list[dict], np.ndarray]:
    """Runs the chart. Returns its trace, and time and force of each step."""
    truth = folder / "truth.csv"
    shutil.copy(store, folder / "store.redb")
    drive = ["--sponge", "right_arm", "--truth", truth, *around]
    options = ["--json", "--store", folder / "store.redb", "--report", folder / "report"]
    said, _ = run(armarium, drive, HERE / "wipe.yaml", options)
    trace = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
    return trace, np.loadtxt(truth, delimiter=",")


def span(trace: list[dict], state: str) -> tuple[float, float]:
    """When a state was entered and left, s."""
    at = {item["item"]["what"]: item["at_ns"] * 1e-9 for item in trace if item.get("item", {}).get("state") == state}
    return at["entered"], at["exited"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("armarium", type=Path, help="the program")
    parser.add_argument("--store", type=Path, default=Path("armarium.redb"))
    # All other options are those of drive.py, such as --tilt 2 -3.
    given, around = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as folder:
        trace, truth = wipe(given.armarium, given.store, Path(folder), ["--height", "0.93", *around])
    begin, end = span(trace, "Wiping")
    adapting = span(trace, "Adapt")
    force = truth[(truth[:, 0] > begin) & (truth[:, 0] < end), 1]
    rms = float(np.sqrt(np.mean((force - FORCE_N) ** 2)))
    lost = float(np.sum(force < LOST_N)) * 1e-3
    print(f"adapting {adapting[1] - adapting[0]:.1f} s, wiping {end - begin:.1f} s")
    print(f"force {force.mean():.2f} N of {FORCE_N:.0f} N, RMS error {rms:.2f} N, {force.min():.1f} to {force.max():.1f} N")
    print(f"contact lost for {lost:.3f} s")
    if rms > RMS_N or lost > 0.0:
        raise SystemExit(f"the RMS error is to be {RMS_N} N at most, without loss of contact")


if __name__ == "__main__":
    main()

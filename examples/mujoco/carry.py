"""Carries a box between both hands in MuJoCo, and judges where it truly was: the driver, `armarium run`, and their figures.

    python examples/mujoco/carry.py target/release/armarium
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from driven import HERE, run

G = 9.81
LIFTED_M, WAY_M, TILT_DEG, LEAST_N, MOST_N, WEIGHT = 0.05, 0.5, 3.0, 5.0, 60.0, 0.05


def drawn(world: Path, seed: int) -> dict[str, Any]:
    """The world with another box: its mass, its edges, its place, how it is turned, and the friction of the pads."""
    random = np.random.default_rng(seed)
    placed = yaml.safe_load(world.read_text())
    box = placed["bodies"][0]
    low, high = [1.0, 0.18, 0.20, -0.02, 0.47, -6.0, 0.6], [3.0, 0.26, 0.22, 0.02, 0.50, 6.0, 0.9]
    mass, depth, height, x, y, yaw, friction = (round(float(value), 4) for value in random.uniform(low, high))
    box.update(mass=mass, size=[box["size"][0], depth, height], at=[x, y], yaw_deg=yaw)
    placed["robot"]["pads"]["friction"] = friction
    return placed


def carry(armarium: Path, placed: dict[str, Any], report: Path, around: list[str]) -> dict[str, tuple[float, bool]]:
    """Runs the chart. Returns the figures, and whether they are as they are to be."""
    report.mkdir(parents=True, exist_ok=True)
    world, truth = report / "drawn.world.yaml", report / "truth.csv"
    world.write_text(yaml.safe_dump(placed))
    options = ["--world", world, "--store", report / "store.redb", "--report", report / "run"]
    chart = HERE.parent.parent / "statecharts" / "carry_box.yaml"
    run(armarium, ["--world", world, "--truth", truth, *around], chart, options)
    weight = json.loads((report / "run" / "report.json").read_text())["outputs"]["weight"]
    off = weight / (placed["bodies"][0]["mass"] * G) - 1.0
    told = np.loadtxt(truth, delimiter=",")
    squeeze, place, (x, y) = told[:, 1:3], told[:, 3:6], told[:, 6:8].T
    upright = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0)))  # of the box's z axis
    lifted = place[:, 2] - place[0, 2]
    carried = lifted > LIFTED_M / 2
    if not carried.any():
        raise SystemExit("the box was not lifted")
    way = np.linalg.norm(np.diff(place[carried, :2], axis=0), axis=1).sum()
    tilt = upright[carried].max() - upright[0]
    return {
        "lifted_m": (lifted.max(), lifted.max() >= LIFTED_M),
        "way_m": (way, way >= WAY_M),
        "tilt_deg": (tilt, tilt <= TILT_DEG),
        "least_n": (squeeze[carried].min(), squeeze[carried].min() >= LEAST_N),
        "most_n": (squeeze.max(), squeeze.max() <= MOST_N),
        "weight_off": (off, abs(off) <= WEIGHT),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("armarium", type=Path, help="the program")
    parser.add_argument("--world", type=Path, default=HERE / "carry.world.yaml", help="with a box and pads")
    parser.add_argument("--seeds", type=int, default=0, help="how many other boxes are drawn, one after the other")
    parser.add_argument("--report", type=Path, help="where the reports are left")
    # All other options are those of drive.py, such as --clock realtime.
    given, around = parser.parse_known_args()
    missed: dict[int, list[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(1, given.seeds + 1) or [0]:
            placed = drawn(given.world, seed) if seed else yaml.safe_load(given.world.read_text())
            try:
                found = carry(given.armarium, placed, (given.report or Path(folder)) / str(seed), around)
            except SystemExit as failed:
                print(f"{seed}: {failed}", flush=True)
                missed[seed] = ["the run"]
                continue
            print(f"{seed}:", ", ".join(f"{name} {value:.3f}" for name, (value, _) in found.items()), flush=True)
            wrong = [name for name, (_, good) in found.items() if not good]
            if wrong:
                missed[seed] = wrong
    if missed:
        raise SystemExit("not as it is to be: " + "; ".join(f"{seed}: {', '.join(wrong)}" for seed, wrong in missed.items()))


if __name__ == "__main__":
    main()

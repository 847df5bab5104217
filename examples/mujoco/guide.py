"""Leads ARMAR-III's hand in MuJoCo, and judges the force that it took: the driver, `armarium run`, and their figures.

    python examples/mujoco/guide.py target/release/armarium --seeds 20
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from driven import HERE, run

MEAN_N, PEAK_N, BEHIND_M = 10.0, 20.0, 0.04
MOVING_M_S = 0.02
AWAY = ["--center", "2.0", "-1.5"]  # no table is in the way


def lead(armarium: Path, seed: int, around: list[str]) -> dict[str, float]:
    """One person leads the hand; what it came to."""
    with tempfile.TemporaryDirectory() as folder:
        truth = Path(folder) / "truth.csv"
        drive = ["--lead", "right_arm", "--truth", truth, "--seed", str(seed), *AWAY, *around]
        options = ["--store", Path(folder) / "store.redb", "--report", Path(folder) / "report"]
        run(armarium, drive, HERE.parent.parent / "statecharts" / "guide.yaml", options)
        told = np.loadtxt(truth, delimiter=",")
    time, force, behind, *place = told[told[:, 1] > 0.0].T
    steps = np.linalg.norm(np.diff(np.array(place)), axis=0)
    moves = steps > MOVING_M_S * np.diff(time)
    return {"mean_n": force[1:][moves].mean(), "peak_n": force.max(), "behind_m": behind[-1], "way_m": steps[moves].sum()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("armarium", type=Path, help="the program")
    parser.add_argument("--seeds", type=int, default=1, help="how many people lead it, one after the other")
    # All other options are those of drive.py, such as --clock realtime.
    given, around = parser.parse_known_args()
    missed = []
    for seed in range(1, given.seeds + 1):
        found = lead(given.armarium, seed, around)
        print(f"{seed}:", ", ".join(f"{name} {value:.3f}" for name, value in found.items()), flush=True)
        if found["mean_n"] > MEAN_N or found["peak_n"] > PEAK_N or found["behind_m"] > BEHIND_M:
            missed.append(seed)
    if missed:
        raise SystemExit(f"missed by {missed}: mean {MEAN_N} N, peak {PEAK_N} N, behind {BEHIND_M} m at most")


if __name__ == "__main__":
    main()

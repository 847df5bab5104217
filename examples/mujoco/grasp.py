"""Grasps in MuJoCo what Armarium's cameras see there, and judges where the thing truly is: the driver, `armarium run`, and the end.

    python examples/mujoco/grasp.py target/release/armarium
"""

from __future__ import annotations

import argparse
import re
import tempfile
from pathlib import Path

from driven import HERE, run

OBJECT, LIFTED_M = "sponge", 0.05


def heights(said: str) -> list[float]:
    """Where the driver says the object was at the start and at the end, m."""
    return [float(found[1]) for found in re.finditer(rf"^{OBJECT} is at \S+ \S+ (\S+)$", said, re.MULTILINE)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("armarium", type=Path, help="the program")
    parser.add_argument("--report", type=Path, help="where its report is left")
    # All other options are those of drive.py, such as --clock realtime.
    given, around = parser.parse_known_args()
    world = HERE / "grasp.world.yaml"
    with tempfile.TemporaryDirectory() as folder:
        report = given.report or Path(folder) / "report"
        options = ["--world", world, "--set", f"object={OBJECT}", "--store", Path(folder) / "store.redb", "--report", report]
        chart = HERE.parent.parent / "statecharts" / "grasp_object.yaml"
        _, said = run(given.armarium, ["--world", world, *around], chart, options)
    start, end = heights(said)
    print(f"the {OBJECT} is {end - start:.3f} m over where it lay")
    if end - start < LIFTED_M:
        raise SystemExit(f"it is to be held {LIFTED_M} m over there at least")


if __name__ == "__main__":
    main()

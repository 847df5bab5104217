"""Armarium in Python: drivers for robots, over Zenoh.

A program of your own subclasses `Driver`, gives samples and takes targets.
"""

from .driver import Driver, Sample
from .gate import WATCHDOG_S, Targets

__all__ = ["WATCHDOG_S", "Driver", "Sample", "Targets"]

"""Armarium in Python: drivers for robots and processors of images, over Zenoh.

A program of your own subclasses `Driver`, gives samples and takes targets; or `Processor`, sees frames and says what it observes.
"""

from .driver import Driver, Sample
from .gate import WATCHDOG_S, Targets
from .processor import Frame, Observation, Processor

__all__ = ["WATCHDOG_S", "Driver", "Frame", "Observation", "Processor", "Sample", "Targets"]

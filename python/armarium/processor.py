"""A processor of images: sees the frames of one provider and says what it observes, for a memory.

It speaks the messages of `docs/wire-images.md` and writes one observation a line, as `armarium memory observe` reads them. It knows no
memory: which observation is of which known thing, and how they are fused, is decided there, for processors in all languages.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TextIO

import cbor2
import numpy as np
import zenoh
from numpy.typing import NDArray

from .driver import _config

FORMATS = {"rgb8": ("u1", 3), "gray8": ("u1", 1), "depth32_f": ("<f4", 1), "depth16": ("<u2", 1), "points32_f": ("<f4", 3)}
"""Formats of raw images that are understood: type and numbers of a pixel."""


@dataclass
class Frame:
    """The images of one time."""

    stamp_ns: int
    """Time of the exposure, by the provider's clock."""
    frame_id: str
    """Name of the first camera's coordinate frame."""
    root_from_camera: Sequence[float] | None
    """Its pose in the robot's root frame, x, y, z (m) and a unit quaternion x, y, z, w, if the provider knows it."""
    images: Mapping[str, NDArray[Any]]
    """By their roles (`left`, `right`, `depth` ...): rows, columns and, where a pixel has several, numbers."""


@dataclass
class Observation:
    """Something that was observed."""

    segment: str
    """The core segment that it is about: `ObjectInstances`, `HumanHands`, or a new one."""
    of_class: str
    """Its class, by which it is told from others in the segment."""
    position: Sequence[float] | None = None
    """Where its centre is, m; `None` when it has no place."""
    frame: str = "root"
    """The frame of the position."""
    deviation: float = 0.01
    """Standard deviation of the position along each axis, m."""
    confidence: float = 1.0
    """0 to 1."""
    attributes: Mapping[str, Any] = field(default_factory=dict)
    """Other attributes, as the segment's schema names them."""

    def line(self, stamp_ns: int) -> str:
        """As one line of JSON."""
        said: dict[str, Any] = {**self.attributes, "segment": self.segment, "class": self.of_class}
        said |= {"stamp_ns": stamp_ns, "confidence": self.confidence}
        if self.position is not None:
            variance = self.deviation**2
            covariance = [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance]
            said |= {"position": [float(x) for x in self.position], "frame": self.frame, "covariance": covariance}
        return json.dumps(said)


class Processor:
    """Sees the frames of a provider. A subclass gives `process`."""

    def __init__(self, agent: str, provider: str) -> None:
        self.agent, self.provider = agent, provider

    def process(self, frame: Frame) -> Sequence[Observation]:
        """What is observed in a frame."""
        raise NotImplementedError

    def run(
        self,
        *,
        frames: int | None = None,
        out: TextIO | None = None,
        listen: Sequence[str] = (),
        connect: Sequence[str] = (),
        config: zenoh.Config | None = None,
    ) -> None:
        """Processes the newest frame, again and again, until there were `frames` of them. By default only this machine is reached.

        What is observed is written to `out`, by default standard output: a line for each observation.
        """
        with zenoh.open(config or _config(listen, connect)) as session:
            newest: Any = zenoh.handlers.RingChannel(1)
            with session.declare_subscriber(f"{self.agent}/image/{self.provider}", newest) as subscriber:
                left = frames
                while left is None or left > 0:
                    frame = decoded(subscriber.recv())
                    if frame is None:
                        continue
                    for observation in self.process(frame):
                        print(observation.line(frame.stamp_ns), file=out or sys.stdout, flush=True)
                    left = None if left is None else left - 1


def decoded(sample: zenoh.Sample) -> Frame | None:
    """The frame in a message; `None` when it is of another version or damaged."""
    if sample.attachment is None:
        return None
    try:
        header = cbor2.loads(sample.attachment.to_bytes())
        if header["version"] != 1:
            return None
        images, at, payload = {}, 0, sample.payload.to_bytes()
        for image in header["images"]:
            part, at = payload[at : at + image["bytes"]], at + image["bytes"]
            if image["coding"] != "raw" or image["format"] not in FORMATS:
                continue
            kind, numbers = FORMATS[image["format"]]
            shape = (image["height"], image["width"]) + ((numbers,) if numbers > 1 else ())
            images[str(image["role"])] = np.frombuffer(part, dtype=kind).reshape(shape)
        return Frame(int(header["stamp_ns"]), str(header["frame_id"]), header["root_from_camera"], images)
    except (KeyError, TypeError, ValueError, cbor2.CBORDecodeError):
        return None

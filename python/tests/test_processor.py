"""What a processor sees of frames on the network, and how it says what it observes."""

from __future__ import annotations

import io
import json
import threading
import time
from typing import Any

import cbor2
import numpy as np
import zenoh

from armarium import Frame, Observation, Processor
from armarium.driver import _config

ENDPOINT = "tcp/127.0.0.1:47461"


def header(**changed: Any) -> bytes:
    image = {"role": "left", "format": "rgb8", "coding": "raw", "width": 4, "height": 2, "bytes": 24}
    said = {"version": 1, "epoch": 1, "number": 1, "stamp_ns": 7, "sent_ns": 0, "frame_id": "eye", "root_from_camera": None}
    return bytes(cbor2.dumps({**said, "images": [image], **changed}))


class Brightest(Processor):
    """Observes the brightest pixel."""

    def process(self, frame: Frame) -> list[Observation]:
        brightness = frame.images["left"].sum(axis=2)
        row, column = np.unravel_index(int(brightness.argmax()), brightness.shape)
        return [Observation("Lights", "lamp", confidence=0.5, attributes={"row": int(row), "column": int(column)})]


def test_a_processor_says_what_it_observes_and_skips_what_it_cannot_read() -> None:
    out = io.StringIO()
    processor = Brightest("test", "eyes")
    with zenoh.open(_config([ENDPOINT], [])) as session:
        worker = threading.Thread(target=lambda: processor.run(frames=1, out=out, connect=[ENDPOINT]), daemon=True)
        worker.start()
        pixels = np.zeros((2, 4, 3), dtype="u1")
        pixels[1, 2] = 200
        until = time.monotonic() + 20
        while worker.is_alive() and time.monotonic() < until:
            for attachment, payload in [
                (header(version=2), pixels.tobytes()),
                (b"\xff", b""),
                (header(), pixels.tobytes()[:5]),
                (header(), pixels.tobytes()),
            ]:
                session.put("test/image/eyes", payload, attachment=attachment)
                time.sleep(0.05)
        worker.join(1)
    said = json.loads(out.getvalue())
    assert said == {"segment": "Lights", "class": "lamp", "stamp_ns": 7, "confidence": 0.5, "row": 1, "column": 2}


def test_a_place_comes_with_its_uncertainty() -> None:
    seen = Observation("ObjectInstances", "cup", position=(1, 2, 3), deviation=0.1)
    said = json.loads(seen.line(5))
    assert said["position"] == [1.0, 2.0, 3.0] and said["frame"] == "root"
    assert abs(said["covariance"][0] - 0.01) < 1e-12 and said["covariance"][1] == 0.0

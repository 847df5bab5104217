"""A driver of joints: the part of a robot below Armarium's guard, for subclassing.

It speaks the messages of `docs/wire-robot.md`. It knows no limbs, no leases and no limits of speed or force: these are the guard's.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import cbor2
import zenoh

from .gate import WATCHDOG_S, Gate, Refused, Targets

AGAIN_S = 0.1
"""A driver in lockstep that hears nothing sends its sample again so often, s."""


Pose = tuple[Sequence[float], Sequence[float]]
"""A position (m) and a unit quaternion x, y, z, w."""


@dataclass
class Sample:
    """What the sensors show, in the order of the driver's joints and wrench sensors."""

    stamp_ns: int
    """Time since the driver's start, ns; it grows from sample to sample."""
    position: Sequence[float]
    """rad (m)"""
    velocity: Sequence[float]
    """rad/s (m/s)"""
    wrenches: Sequence[Sequence[float]] = ()
    """For each sensor force (N) and torque (N m) that the hand exerts on it, in the sensor's frame, about its origin."""
    bodies: Mapping[str, Pose] = field(default_factory=dict)
    """Where bodies are, by their names, in the frame in which the odometry began. A simulation tells it, for cameras that draw
    its scene, about as often as they take pictures; other samples have none."""


class Driver:
    """Joints and wrench sensors. A subclass gives `sample` and `apply`, and in real time `brake`.

    In lockstep, time passes in `apply`: it moves the joints by one period. In real time `sample` is called once a period,
    whatever comes; `apply` when targets have come, and `brake` in each period without them after 50 ms.
    """

    def __init__(
        self,
        agent: str,
        name: str,
        *,
        joints: Sequence[str],
        wrenches: Sequence[str] = (),
        rate_hz: float = 1000.0,
        clock: Literal["lockstep", "realtime"] = "realtime",
        bodies: Sequence[str] = (),
    ) -> None:
        if clock not in ("lockstep", "realtime"):
            raise ValueError(f"clock is lockstep or realtime, not {clock!r}")
        if not 1.0 <= rate_hz <= 10_000.0:
            raise ValueError(f"rate_hz is 1 to 10000, not {rate_hz}")
        self.agent, self.name = agent, name
        self.joints, self.wrenches, self.bodies = list(joints), list(wrenches), list(bodies)
        self.rate_hz, self.clock = float(rate_hz), clock
        self._stopped = threading.Event()

    def sample(self) -> Sample:
        """What the sensors show now."""
        raise NotImplementedError

    def apply(self, targets: Targets) -> None:
        """Gives targets to the drives; in lockstep, lets one period pass."""
        raise NotImplementedError

    def brake(self) -> None:
        """Lets the joints brake and stand: nobody commands them. A driver in real time must do that."""
        if self.clock == "realtime":
            raise NotImplementedError

    def stop(self) -> None:
        """Ends `serve`, from any thread."""
        self._stopped.set()

    def serve(
        self,
        *,
        listen: Sequence[str] = (),
        connect: Sequence[str] = (),
        config: zenoh.Config | None = None,
        ready: Callable[[], None] = lambda: None,
    ) -> None:
        """Serves until `stop` is called. By default only this machine is reached, and nobody is searched for.

        `config` is Zenoh's own configuration, for TLS and other networks. `ready` is called when guards can connect.
        """
        with zenoh.open(config or _config(listen, connect)) as session:
            served = _Served(self, session)
            ready()
            try:
                served.drive(self._stopped)
            finally:
                self.brake()


def _config(listen: Sequence[str], connect: Sequence[str]) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", json.dumps(list(listen)))
    config.insert_json5("connect/endpoints", json.dumps(list(connect)))
    config.insert_json5("scouting/multicast/enabled", "false")
    # Until it is known what others declare, everything is sent to them; Zenoh may wait half a second for that in vain.
    config.insert_json5("open/return_conditions/declares", "false")
    return config


def _schema(name: str) -> str:
    return f"application/cbor;drive/{name};v1"


class _Served:
    """A driver in a session: answers claims, takes targets, sends samples."""

    def __init__(self, driver: Driver, session: zenoh.Session) -> None:
        self.driver = driver
        self.epoch = time.time_ns()
        self.changed = threading.Condition()
        realtime = driver.clock == "realtime"
        self.gate = Gate(len(driver.joints), realtime, 1.0 / driver.rate_hz, self.epoch)
        self.description = {
            "joints": driver.joints,
            "wrenches": driver.wrenches,
            "rate_hz": driver.rate_hz,
            "clock": driver.clock,
            "epoch": self.epoch,
            "watchdog_s": WATCHDOG_S,
            "bodies": driver.bodies,
        }
        key = f"{driver.agent}/drive/{driver.name}"
        self.publisher = session.declare_publisher(
            f"{key}/sample",
            encoding=_schema("sample"),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )
        self.declared = [
            session.declare_subscriber(f"{key}/targets", self._targets),
            session.declare_queryable(f"{key}/claim", self._asked),
            # Last: who knows the description can claim the driver.
            session.declare_queryable(f"{key}/description", self._asked),
        ]

    def _targets(self, message: zenoh.Sample) -> None:
        with self.changed:
            try:
                self.gate.offer(_read(message, "targets"), time.monotonic())
            except Refused as why:
                self.gate.refuse(str(why))
            self.changed.notify()

    def _asked(self, query: zenoh.Query) -> None:
        """A question without a payload changes nothing; with one it claims the driver or gives it back."""
        with query:
            try:
                if query.payload is not None and len(query.payload.to_bytes()) > 0:
                    self._claimed(query)
                described = self.description | {"claims": self.gate.claims}
                query.reply(query.key_expr, cbor2.dumps(described), encoding=_schema("description"))
            except Refused as why:
                query.reply_err(cbor2.dumps({"reason": str(why)}), encoding=_schema("refusal"))

    def _claimed(self, query: zenoh.Query) -> None:
        released = str(query.encoding) == _schema("release")
        asked = _read(query, "release" if released else "claim")
        with self.changed:
            if released:
                self.gate.release(str(asked.get("commander")))
            else:
                caller = str(asked.get("caller") or "somebody")
                self.gate.claim(str(asked.get("commander") or ""), caller, time.monotonic())

    def drive(self, stopped: threading.Event) -> None:
        """Sends samples and applies what comes, until stopped."""
        number, due, period_s = 0, time.monotonic(), 1.0 / self.driver.rate_hz
        realtime = self.driver.clock == "realtime"
        while not stopped.is_set():
            if realtime:
                # A period that was missed is not made up for.
                due = max(due + period_s, time.monotonic() - period_s)
                time.sleep(max(0.0, due - time.monotonic()))
            with self.changed:
                braked, refused = self.gate.begin_sample(number, time.monotonic())
            payload = self._sample(number, braked, refused)
            self.publisher.put(payload)
            targets = self._taken() if realtime else self._awaited(payload, stopped)
            if targets is not None:
                self.driver.apply(targets)
            elif braked:
                self.driver.brake()
            number += 1

    def _taken(self) -> Targets | None:
        with self.changed:
            return self.gate.take()

    def _awaited(self, payload: bytes, stopped: threading.Event) -> Targets | None:
        """Waits for targets; the sample is sent again now and then, as it or its answer may be lost."""
        while not stopped.is_set():
            with self.changed:
                targets = self.gate.take()
                if targets is None and self.changed.wait(AGAIN_S):
                    targets = self.gate.take()
            if targets is not None:
                return targets
            self.publisher.put(payload)
        return None

    def _sample(self, number: int, braked: bool, refused: str | None) -> bytes:
        sample = self.driver.sample()
        self._check(sample)
        return cbor2.dumps(
            {
                "epoch": self.epoch,
                "number": number,
                "stamp_ns": int(sample.stamp_ns),
                "position": [float(value) for value in sample.position],
                "velocity": [float(value) for value in sample.velocity],
                "wrenches": [[float(value) for value in wrench] for wrench in sample.wrenches],
                "braked": braked,
                "refused": refused,
                "claims": self.gate.claims,
                "bodies": {name: _pose(pose) for name, pose in sample.bodies.items()},
            }
        )


    def _check(self, sample: Sample) -> None:
        """A sample of other joints or sensors than were described is an error of the program that gives it."""
        joints, sensors = len(self.driver.joints), len(self.driver.wrenches)
        for what, got, expected in (
            ("positions", len(sample.position), joints),
            ("velocities", len(sample.velocity), joints),
            ("wrenches", len(sample.wrenches), sensors),
        ):
            if got != expected:
                raise ValueError(f"a sample with {got} {what}; the driver has described {expected}")
        for name, wrench in zip(self.driver.wrenches, sample.wrenches, strict=True):
            if len(wrench) != 6:
                raise ValueError(f"the wrench of `{name}` has {len(wrench)} numbers: force and torque are 6")


def _pose(pose: Pose) -> list[list[float]]:
    position, rotation = pose
    if len(position) != 3 or len(rotation) != 4:
        raise ValueError("a pose is a position of 3 numbers and a quaternion of 4")
    return [[float(value) for value in position], [float(value) for value in rotation]]


def _read(message: zenoh.Sample | zenoh.Query, name: str) -> dict[str, Any]:
    """The content of a message, if it is of that schema."""
    if str(message.encoding) != _schema(name):
        raise Refused(f"`{message.encoding}` is not `{_schema(name)}`, which is understood here")
    payload = message.payload
    try:
        content = cbor2.loads(payload.to_bytes() if payload is not None else b"")
    except Exception as error:  # what a decoder raises on bad bytes is its own affair
        raise Refused(f"a message that is no CBOR: {error}") from error
    if not isinstance(content, dict):
        raise Refused("a message that is no map")
    return content

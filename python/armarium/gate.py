"""Whose targets a driver takes, and which of them. Pure: times are handed in; it knows no network.

One commander at a time has the driver: who has claimed it, until he releases it, or has been silent for so long that another may
claim it. Of his targets those count that answer a recent sample, in the order of the samples. After the joints have braked by
themselves, only targets of somebody who knows that count.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

WATCHDOG_S = 0.05
"""How long a driver in real time waits for targets before it brakes, s."""

SILENCE_S = 1.0
"""After so long without targets another commander may claim the driver, s."""


MAX_NAME = 200
"""Longest name of a commander or a caller."""


class Refused(Exception):
    """Why a claim or targets are refused."""


@dataclass
class Targets:
    """Targets of the drives, in the order of the driver's joints."""

    position: list[float]
    """rad (m)"""
    velocity: list[float]
    """rad/s (m/s)"""


@dataclass
class _Commander:
    id: str
    caller: str
    heard_s: float


class Gate:
    """See the module. `realtime` says whether the joints brake without targets."""

    def __init__(self, joints: int, realtime: bool, period_s: float, epoch: int) -> None:
        self._joints, self._realtime, self._period_s, self._epoch = joints, realtime, period_s, epoch
        self._commander: _Commander | None = None
        self.claims = 0
        self._newest = 0
        self._answered = -1
        self._braked_since: int | None = 0 if realtime else None
        self._taken: Targets | None = None
        self._refused: str | None = None

    def begin_sample(self, number: int, now_s: float) -> tuple[bool, str | None]:
        """A sample is about to be sent. Returns whether its joints have braked, and why targets were refused."""
        self._newest = number
        silent = self._commander is None or now_s - self._commander.heard_s > WATCHDOG_S
        if silent and self._realtime:
            self._brake(number)
        refused, self._refused = self._refused, None
        return self._braked_since is not None, refused

    def claim(self, commander: str, caller: str, now_s: float) -> None:
        """Somebody asks for the right to send targets."""
        if not commander or max(len(commander), len(caller)) > MAX_NAME:
            raise Refused(f"a commander has a name of 1 to {MAX_NAME} bytes, a caller one of at most so many")
        by = self._commander
        if by is not None and by.id != commander and now_s - by.heard_s <= SILENCE_S:
            raise Refused(f"it is commanded by `{by.caller}`")
        self.claims += 1
        self._commander = _Commander(commander, caller, now_s)
        self._give_up_last()

    def release(self, commander: str) -> None:
        """The commander gives the right back."""
        if self._commander is not None and self._commander.id == commander:
            self._commander = None
            self._give_up_last()

    def offer(self, message: dict[str, Any], now_s: float) -> None:
        """Targets have come; why they are refused is said in the next sample."""
        try:
            self._taken = self._checked(message)
        except Refused as why:
            self._refused = str(why)
            return
        self._answered, self._braked_since = message["number"], None
        if self._commander is not None:
            self._commander.heard_s = now_s

    def refuse(self, reason: str) -> None:
        """Something else than targets has come in their place."""
        self._refused = reason

    def take(self) -> Targets | None:
        """The targets that have come since the last call."""
        taken, self._taken = self._taken, None
        return taken

    def _brake(self, number: int) -> None:
        if self._braked_since is None:
            self._braked_since = number
        self._taken = None

    def _give_up_last(self) -> None:
        self._answered, self._taken = -1, None
        if self._realtime:
            self._brake(self._newest + 1)

    def _checked(self, message: dict[str, Any]) -> Targets:
        try:
            number, position, velocity = int(message["number"]), message["position"], message["velocity"]
            targets = Targets([float(value) for value in position], [float(value) for value in velocity])
            commander, epoch = message["commander"], message["epoch"]
        except (KeyError, TypeError, ValueError) as error:
            raise Refused(f"targets that are not understood: {error!r}") from error
        if self._commander is None:
            raise Refused("targets of somebody who has not claimed the driver")
        if commander != self._commander.id:
            raise Refused(f"targets of somebody else than `{self._commander.caller}`, who has claimed the driver")
        if epoch != self._epoch:
            raise Refused("targets for another start of the driver")
        if number > self._newest:
            raise Refused(f"targets for the sample {number}, which has not been sent")
        if number <= self._answered:
            raise Refused(f"targets for the sample {number}, which was answered, or is older than that")
        age_s = (self._newest - number) * self._period_s
        if age_s > WATCHDOG_S:
            raise Refused(f"targets for a sample that is {age_s * 1e3:.0f} ms old")
        if self._braked_since is not None and number < self._braked_since:
            raise Refused("targets for a sample from before the joints braked")
        n = self._joints
        if len(targets.position) != n or len(targets.velocity) != n:
            raise Refused(f"targets with {len(position)} positions and {len(velocity)} velocities for {n} joints")
        if not all(math.isfinite(value) for value in targets.position + targets.velocity):
            raise Refused("targets that are not finite numbers")
        return targets

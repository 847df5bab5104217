"""A driver in a session, and a commander in another one that does everything right and wrong."""

import contextlib
import dataclasses
import json
import math
import queue
import socket
import threading

import cbor2
import pytest
import zenoh

import armarium


def schema(name, version=1):
    return f"application/cbor;drive/{name};v{version}"


class Joints(armarium.Driver):
    """Two ideal joints."""

    def __init__(self, clock):
        super().__init__("lab", "arm", joints=["shoulder", "elbow"], wrenches=["wrist"], rate_hz=500, clock=clock)
        self.time_ns, self.targets, self.brakes = 0, armarium.Targets([0.0, 0.0], [0.0, 0.0]), 0

    def sample(self):
        if self.clock == "realtime":
            self.time_ns += 2_000_000
        return armarium.Sample(self.time_ns, self.targets.position, self.targets.velocity, [[0.0] * 6])

    def apply(self, targets):
        self.targets = targets
        if self.clock == "lockstep":
            self.time_ns += 2_000_000

    def brake(self):
        self.brakes += 1


class Commander:
    """The side of a guard."""

    def __init__(self, session):
        self.session, self.samples = session, queue.Queue()
        self.declared = session.declare_subscriber("lab/drive/arm/sample", self._came)
        self.name = "test"

    def _came(self, message):
        assert str(message.encoding) == schema("sample")
        self.samples.put(cbor2.loads(message.payload.to_bytes()))

    def ask(self, part, content=None, encoding=None):
        """The answer, or the reason of a refusal."""
        given = {} if content is None else {"payload": cbor2.dumps(content), "encoding": encoding}
        for _ in range(100):
            for reply in self.session.get(f"lab/drive/arm/{part}", timeout=2.0, **given):
                answer = reply.ok or reply.err
                return cbor2.loads(answer.payload.to_bytes())
            threading.Event().wait(0.02)  # the link may not know the driver yet
        raise AssertionError("nobody answers")

    def claim(self):
        return self.ask("claim", {"commander": self.name, "caller": "a test"}, schema("claim"))

    def sample(self):
        return self.samples.get(timeout=5.0)

    def answer(self, sample, encoding=None, **change):
        targets = {
            "commander": self.name,
            "epoch": sample["epoch"],
            "number": sample["number"],
            "position": [0.1, 0.2],
            "velocity": [0.0, 0.0],
        } | change
        self.session.put("lab/drive/arm/targets", cbor2.dumps(targets), encoding=encoding or schema("targets"))


def configured(kind, endpoint):
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5(f"{kind}/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    if kind == "connect":
        config.insert_json5("listen/endpoints", "[]")
    return config


@contextlib.contextmanager
def served(clock):
    """A driver and a session of its commander."""
    with socket.socket() as tried:
        tried.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{tried.getsockname()[1]}"
    driver, ready = clock if isinstance(clock, Joints) else Joints(clock), threading.Event()
    thread = threading.Thread(target=driver.serve, kwargs={"listen": [endpoint], "ready": ready.set})
    thread.start()
    try:
        assert ready.wait(10.0)
        with zenoh.open(configured("connect", endpoint)) as session:
            yield driver, Commander(session)
    finally:
        driver.stop()
        thread.join()


def test_in_lockstep_time_passes_with_the_targets():
    with served("lockstep") as (driver, commander):
        described = commander.claim()
        assert described["joints"] == ["shoulder", "elbow"]
        assert (described["clock"], described["rate_hz"], described["wrenches"]) == ("lockstep", 500.0, ["wrist"])
        for number in range(50):
            sample = commander.sample()
            while sample["number"] < number:  # one that was sent again
                sample = commander.sample()
            assert (sample["number"], sample["stamp_ns"]) == (number, number * 2_000_000)
            commander.answer(sample, position=[0.01 * number, 0.0])
        assert sample["position"] == [pytest.approx(0.48), 0.0]
        # Nobody answers any more: the sample comes again, and time stands still.
        repeated = [commander.sample() for _ in range(3)]
        assert {sample["number"] for sample in repeated} == {50}
        assert driver.time_ns == 100_000_000


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"commander": "stranger"}, "somebody else than `a test`"),
        ({"epoch": 1}, "another start"),
        ({"position": [math.nan, 0.0]}, "not finite"),
        ({"position": [0.0]}, "for 2 joints"),
        ({"number": 10**9}, "has not been sent"),
        ({"encoding": schema("targets", 2)}, "drive/targets;v2` is not"),
    ],
)
def test_what_is_wrong_is_refused_in_the_next_sample(change, reason):
    with served("realtime") as (driver, commander):
        commander.claim()
        while not (sample := commander.sample())["braked"]:
            pass
        commander.answer(sample, **change)
        while (sample := commander.sample())["refused"] is None:
            pass
        assert reason in sample["refused"]
        assert driver.targets.position == [0.0, 0.0]


def test_a_second_commander_and_another_version_are_refused():
    with served("lockstep") as (_, commander):
        commander.claim()
        commander.name = "second"
        assert commander.claim() == {"reason": "it is commanded by `a test`"}
        other = commander.ask("claim", {"commander": "x"}, schema("claim", 9))
        assert "drive/claim;v9` is not" in other["reason"]
        commander.name = "test"
        commander.ask("claim", {"commander": "test"}, schema("release"))
        commander.name = "second"
        described = commander.claim()
        assert (described["joints"], described["claims"]) == (["shoulder", "elbow"], 2)
        commander.answer(commander.sample())
        while (sample := commander.sample())["number"] == 0:
            pass
        assert sample["claims"] == 2


def test_samples_tell_where_bodies_are():
    class Kitchen(Joints):
        def __init__(self):
            super().__init__("lockstep")
            self.bodies = ["cup"]

        def sample(self):
            return dataclasses.replace(super().sample(), bodies={"cup": ([0.1, 0.2, 0.3], [0.0, 0.0, 0.0, 1.0])})

    with served(Kitchen()) as (_, commander):
        assert commander.claim()["bodies"] == ["cup"]
        assert commander.sample()["bodies"] == {"cup": [[0.1, 0.2, 0.3], [0.0, 0.0, 0.0, 1.0]]}


def test_in_real_time_it_brakes_without_targets():
    with served("realtime") as (driver, commander):
        commander.claim()
        moving = 0
        for _ in range(200):
            sample = commander.sample()
            commander.answer(sample)
            moving += not sample["braked"]
        assert moving > 50, "while targets come it is not braked"
        assert driver.targets.position == [0.1, 0.2]
        before = driver.brakes
        while not commander.sample()["braked"]:
            pass
        threading.Event().wait(0.1)
        assert driver.brakes > before, "it goes on braking"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"position": [0.0]}, "1 positions; the driver has described 2"),
        ({"velocity": [0.0] * 3}, "3 velocities; the driver has described 2"),
        ({"wrenches": []}, "0 wrenches; the driver has described 1"),
        ({"wrenches": [[0.0] * 3]}, "the wrench of `wrist` has 3 numbers"),
        ({"bodies": {"cup": ([0.0], [0.0] * 4)}}, "a pose is a position of 3 numbers"),
    ],
)
def test_a_sample_of_other_joints_than_were_described_ends_the_driver_with_the_reason(change, reason):
    class Wrong(Joints):
        def sample(self):
            return dataclasses.replace(super().sample(), **change)

    driver = Wrong("realtime")
    with pytest.raises(ValueError, match=reason):
        driver.serve()
    assert driver.brakes == 1

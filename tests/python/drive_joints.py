"""Drives ideal joints as `eve/arm`, in lockstep: the whole of what docs/wire-robot.md asks of such a driver, in Python.

Needs the packages eclipse-zenoh and cbor2. Usage: drive_joints.py tcp/127.0.0.1:PORT JOINT... [+ SENSOR...]
"""

import json
import queue
import random
import sys
import threading
import time

import cbor2
import zenoh

KEY = "eve/drive/arm"
PERIOD_NS = 1_000_000
AGAIN_S = 0.1  # a sample that nobody answers is sent again
SILENCE_S = 1.0  # then somebody else may claim the driver


def schema(name):
    return f"application/cbor;drive/{name};v1"


class Driver:
    def __init__(self, session, joints, sensors):
        self.joints, self.sensors = joints, sensors
        self.epoch, self.number = time.time_ns(), 0
        self.position, self.velocity = [0.0] * len(joints), [0.0] * len(joints)
        self.commander, self.heard, self.refused = None, 0.0, None
        self.came, self.random = queue.SimpleQueue(), random.Random(1)
        self.samples = session.declare_publisher(
            f"{KEY}/sample", encoding=schema("sample"), priority=zenoh.Priority.REAL_TIME, express=True
        )

    def description(self):
        return {
            "joints": self.joints,
            "wrenches": self.sensors,
            "rate_hz": 1e9 / PERIOD_NS,
            "clock": "lockstep",
            "epoch": self.epoch,
        }

    def asked(self, query):
        """On `description` and on `claim`."""
        with query:
            if query.payload is not None and not self.claimed(query):
                return
            query.reply(query.key_expr, cbor2.dumps(self.description()), encoding=schema("description"))

    def claimed(self, query):
        asked, message = str(query.encoding), cbor2.loads(query.payload.to_bytes())
        free = self.commander is None or time.monotonic() - self.heard > SILENCE_S
        if asked == schema("release"):
            if message["commander"] == self.commander:
                self.commander = None
        elif asked != schema("claim"):
            return self.refuse(query, f"`{asked}` is not understood here")
        elif free or message["commander"] == self.commander:
            self.commander, self.heard = message["commander"], time.monotonic()
        else:
            return self.refuse(query, "somebody else commands it")
        return True

    def refuse(self, query, reason):
        query.reply_err(cbor2.dumps({"reason": reason}), encoding=schema("refusal"))
        return False

    def sample(self):
        # A sensor that repeats itself to the bit counts as broken.
        noise = lambda: [self.random.gauss(0.0, 1e-3) for _ in range(6)]
        return cbor2.dumps(
            {
                "epoch": self.epoch,
                "number": self.number,
                "stamp_ns": (self.number + 1) * PERIOD_NS,
                "position": self.position,
                "velocity": self.velocity,
                "wrenches": [noise() for _ in self.sensors],
                "refused": self.refused,
            }
        )

    def wrong(self, targets):
        """Why targets are not taken, if so."""
        if targets["commander"] != self.commander:
            return "targets of somebody who has not claimed the driver"
        if (targets["epoch"], targets["number"]) != (self.epoch, self.number):
            return "targets for another sample"
        return None

    def drive(self, ends):
        while not ends.is_set():
            sample, self.refused = self.sample(), None
            targets = self.answer(sample, ends)
            if targets is not None:
                self.heard = time.monotonic()
                self.position, self.velocity = targets["position"], targets["velocity"]
                self.number += 1

    def answer(self, sample, ends):
        """The targets for a sample, which is sent again until they come."""
        while not ends.is_set():
            self.samples.put(sample)
            try:
                message = self.came.get(timeout=AGAIN_S)
            except queue.Empty:
                continue
            targets = cbor2.loads(message.payload.to_bytes())
            self.refused = self.wrong(targets)
            if self.refused is None:
                return targets
        return None


def main():
    endpoint, *names = sys.argv[1:]
    at = names.index("+") if "+" in names else len(names)
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        driver = Driver(session, names[:at], names[at + 1 :])
        declared = [
            session.declare_subscriber(f"{KEY}/targets", driver.came.put),
            session.declare_queryable(f"{KEY}/claim", driver.asked),
            # Last: who knows the description can claim the driver.
            session.declare_queryable(f"{KEY}/description", driver.asked),
        ]
        ends = threading.Event()
        driving = threading.Thread(target=driver.drive, args=(ends,))
        driving.start()
        print("eve is ready", flush=True)
        sys.stdin.read()  # until whoever started it closes its input
        ends.set()
        driving.join()
        for declaration in declared:
            declaration.undeclare()


main()

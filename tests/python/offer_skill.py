"""Offers the skill `Sum` as the agent `eve`: the whole of what docs/wire.md asks for, in Python.

Needs the packages eclipse-zenoh and cbor2. Usage: offer_skill.py tcp/127.0.0.1:PORT
"""

import json
import sys
import threading
import time

import cbor2
import zenoh

LEASE_S = 0.5
KEY = "eve/chart/Sum"


def schema(name):
    return f"application/cbor;runtime/{name};v1"


class Call:
    """One call: it runs in a thread of its own, until it has ended or its caller is gone."""

    def __init__(self, inputs):
        self.changed = threading.Condition()
        self.revision, self.events, self.ended = 0, [], None
        self.cancelled = threading.Event()
        self.heard = time.monotonic()
        threading.Thread(target=self.run, args=(inputs,), daemon=True).start()

    def tell(self, event=None, ended=None):
        with self.changed:
            self.revision += 1
            if event:
                self.events.append({"revision": self.revision, "name": event[0], "data": event[1]})
            self.ended = self.ended or ended
            self.changed.notify_all()

    def run(self, inputs):
        numbers = [item["float"] for item in inputs["numbers"]["list"]]
        self.tell(event=("summing", {"int": len(numbers)}))
        until = time.monotonic() + inputs["takes"]["duration"]
        while time.monotonic() < until and not self.cancelled.wait(0.01):
            if time.monotonic() - self.heard > LEASE_S:
                self.cancelled.set()  # its caller is gone
        if not numbers:
            self.tell(ended={"outcome": "failure", "reason": "there is nothing to sum", "outputs": {}})
        else:
            outputs = {"sum": {"float": float(sum(numbers))}}
            self.tell(ended={"outcome": "success", "reason": None, "outputs": outputs})

    def status(self, seen, wait_s):
        with self.changed:
            self.heard = time.monotonic()
            self.changed.wait_for(lambda: self.revision > seen or self.ended, timeout=min(wait_s, 0.1))
            return {
                "revision": self.revision,
                "leaves": [] if self.ended else ["adding"],
                "events": [event for event in self.events if event["revision"] > seen],
                "ended": self.ended,
            }


class Agent:
    def __init__(self, session):
        self.calls = {}
        self.manifest = {
            "name": "Sum",
            "instance": str(session.info.zid()),
            "version": "1",
            "description": "Sums numbers, slowly if asked.",
            "inputs": [
                {"name": "numbers", "type": {"list": {"float": None}}, "default": None, "description": "What to sum."},
                {"name": "takes", "type": "duration", "default": {"duration": 0.0}, "description": "How long."},
            ],
            "outputs": [
                {"name": "sum", "type": {"float": None}, "default": None, "description": "The sum."}
            ],
            "outcomes": [],
            "events": ["summing"],
            "limbs": [],
            "grace_s": 0.5,
        }

    def answer(self, query):
        """Runs on a thread of its own, as a poll may wait."""
        with query:
            if query.payload is None:
                return self.reply(query, "manifest", self.manifest)
            asked, message = str(query.encoding), cbor2.loads(query.payload.to_bytes())
            if asked == schema("start"):
                if message["instance"] != self.manifest["instance"]:
                    return  # another process is meant
                if message["version"] != self.manifest["version"]:
                    return self.refuse(query, f"this is version {self.manifest['version']} of `Sum`")
                call = self.calls.setdefault(message["call"], None) or Call(message["inputs"])
                self.calls[message["call"]] = call
                return self.reply(query, "status", call.status(0, 0))
            call = self.calls.get(message["call"])
            if call is None:
                return  # another process has it
            if asked == schema("cancel"):
                call.cancelled.set()
                return self.reply(query, "status", call.status(0, 0))
            if asked == schema("poll"):
                return self.reply(query, "status", call.status(message["seen"], message["wait_s"]))
            self.refuse(query, f"`{asked}` is not understood here")

    def reply(self, query, name, message):
        query.reply(KEY, cbor2.dumps(message), encoding=schema(name))

    def refuse(self, query, reason):
        query.reply_err(cbor2.dumps({"reason": reason}), encoding=schema("refusal"))


def main():
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        agent = Agent(session)

        def asked(query):
            threading.Thread(target=agent.answer, args=(query,), daemon=True).start()

        queryable = session.declare_queryable("eve/chart/*", asked)
        print("eve is ready", flush=True)
        sys.stdin.read()  # until whoever started it closes its input
        queryable.undeclare()


main()

"""Which targets a driver takes; the same cases as in Rust."""

import math

import pytest
from armarium.gate import Gate, Refused


def targets(commander="a", number=95, **change):
    return {"commander": commander, "epoch": 7, "number": number, "position": [0.1, 0.2], "velocity": [0.0, 0.0]} | change


@pytest.fixture
def gate():
    """A driver of two joints in real time that `a` has claimed, and that has sent the samples 0 to 100."""
    gate = Gate(2, True, 0.001, 7)
    gate.claim("a", "a", 0.0)
    for number in range(101):
        gate.begin_sample(number, 0.001)
    gate.offer(targets(number=90), 0.001)
    assert gate.take() is not None
    return gate


@pytest.mark.parametrize(
    ("offered", "reason"),
    [
        (targets("b"), "somebody else than `a`"),
        (targets(number=90), "which was answered"),
        (targets(number=89), "or is older than that"),
        (targets(number=101), "has not been sent"),
        (targets(epoch=6), "another start"),
        (targets(position=[0.0, 0.0, 0.0]), "3 positions and 2 velocities for 2 joints"),
        (targets(velocity=[0.0, math.nan]), "not finite"),
        (targets(position=[math.inf, 0.0]), "not finite"),
        (targets(position=["x", 0.0]), "not understood"),
        (targets(number=None), "not understood"),
        ({}, "not understood"),
    ],
)
def test_targets_that_do_not_fit_are_refused_with_a_reason(gate, offered, reason):
    gate.offer(offered, 0.001)
    assert gate.take() is None
    _, refused = gate.begin_sample(101, 0.001)
    assert reason in refused
    gate.offer(targets(number=101), 0.001)
    assert gate.take() is not None, "what fits is taken after it"


def test_late_targets_are_refused(gate):
    for number in range(101, 161):
        gate.begin_sample(number, 0.001)
    gate.offer(targets(number=101), 0.001)
    assert "59 ms old" in gate.begin_sample(161, 0.001)[1]


def test_after_it_has_braked_only_who_knows_that_commands(gate):
    assert not gate.begin_sample(101, 0.051)[0]
    assert gate.begin_sample(102, 0.052)[0]
    gate.offer(targets(number=101), 0.052)
    assert gate.take() is None
    assert "before the joints braked" in gate.begin_sample(103, 0.053)[1]
    gate.offer(targets(number=102), 0.053)
    assert gate.take() is not None
    assert not gate.begin_sample(104, 0.054)[0]


def test_a_driver_has_one_commander_until_he_is_silent(gate):
    with pytest.raises(Refused, match="it is commanded by `a`"):
        gate.claim("b", "b", 1.0)
    for nobody in ("", "x" * 201):
        with pytest.raises(Refused, match="1 to 200 bytes"):
            gate.claim(nobody, "b", 5.0)
    gate.claim("a", "a", 1.0)
    gate.claim("b", "b", 2.002)
    assert gate.begin_sample(101, 2.002)[0], "a new commander begins with joints that stand"
    gate.offer(targets("a", 101), 2.002)
    assert gate.take() is None
    gate.release("a")
    gate.offer(targets("b", 101), 2.002)
    assert gate.take() is not None, "only who has it can give it back"

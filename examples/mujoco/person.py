"""A person in MuJoCo who takes a hand of the robot, leads it along a way, turns it, and lets go.

A hand of some mass on a spring and a damper, pulled to where the person wants it; a grip joins it to the robot's hand, and a wrist turns
what it holds. The person sees where the robot's hand is and knows nothing else of the robot.
"""

from __future__ import annotations

import mujoco
import numpy as np

GRIP_N_M, TURNED_KGM2, DAMPED = 3000.0, 0.05, 0.7  # of a palm that holds something; of a hand that a wrist turns
REACH_S, SETTLE_S, RAMP_S, HOLD_S = 1.0, 0.5, 0.5, 1.0
SPEED_M_S, ROUND_S = 0.2, 0.15  # along the way; time constant of each of two low-passes that round its corners
STRENGTH_N, TREMOR_HZ = 60.0, 9.0
RESTS = np.array([0.42, 0.60, 0.90])  # where the hand hangs, m
# How far from where it was taken the hand is led, m, each from and to; the ranges of `statecharts/guide.world.yaml`.
WAY = np.array(
    [
        [[-0.16, -0.10], [0.00, 0.08], [0.02, 0.10]],
        [[-0.04, 0.06], [0.06, 0.12], [0.06, 0.14]],
        [[0.04, 0.10], [-0.05, 0.02], [-0.02, 0.04]],
        [[-0.16, -0.10], [0.00, 0.06], [0.02, 0.08]],
    ]
)
TURN_DEG = 11.0  # about each axis, at most


def smooth(share: float) -> float:
    """From 0 to 1 with the least jerk."""
    s = min(max(share, 0.0), 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """Of a turn about a vector, by its length, rad."""
    quat, matrix = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(9)
    mujoco.mju_quatIntegrate(quat, vector, 1.0)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """The inverse of `rotation_matrix`."""
    quat, vector = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quat, matrix.ravel())
    mujoco.mju_quat2Vel(vector, quat, 1.0)
    return vector


class Person:
    """Whose habits a seed draws.

    `force_n` is what they do to the robot's hand, `behind_m` how far their own is from where they want it; both are 0 while they hold nothing.
    """

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        self.mass, self.stiffness, self.damping, self.wrist, self.tremor, self.begins = random.uniform(
            [1.0, 100.0, 5.0, 5.0, 0.0, 8.0], [3.0, 800.0, 40.0, 20.0, 0.002, 11.0]
        )
        self.turn = np.radians(random.uniform(-TURN_DEG, TURN_DEG, 3))
        self.places = np.vstack([np.zeros(3), random.uniform(WAY[..., 0], WAY[..., 1])])
        legs = np.linalg.norm(np.diff(self.places, axis=0), axis=1)
        self.gone = np.concatenate([[0.0], np.cumsum(legs)])
        self.lets_go = self.begins + REACH_S + SETTLE_S + self.gone[-1] / SPEED_M_S + RAMP_S + 4 * ROUND_S + HOLD_S
        self.rounded = np.zeros((2, 3))
        self.force_n = self.behind_m = 0.0
        self.taken: np.ndarray | None = None
        self.before = RESTS
        self.grip: tuple[np.ndarray, np.ndarray] | None = None

    def add(self, spec: mujoco.MjSpec) -> None:
        """Their hand, which touches nothing but what it holds."""
        hand = spec.worldbody.add_body(name="person_hand", pos=RESTS, gravcomp=1.0)
        for i, axis in enumerate(np.eye(3)):
            hand.add_joint(name=f"person_{i}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        hand.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.04, 0, 0], mass=self.mass, contype=0, conaffinity=0)

    def wanted(self, time: float, dt: float, seen: np.ndarray) -> tuple[np.ndarray, float]:
        """Where they want their hand, and what share of the turn."""
        if self.taken is None or time < self.begins + REACH_S:
            self.taken = seen.copy()
            return RESTS + (seen - RESTS) * smooth((time - self.begins) / REACH_S), 0.0
        led = time - self.begins - REACH_S - SETTLE_S
        # A speed that rises and falls evenly: the mean over a ramp.
        ramp = np.clip(SPEED_M_S * (led - RAMP_S * (np.arange(16) + 0.5) / 16), 0.0, self.gone[-1])
        along = float(ramp.mean())
        place = np.array([np.interp(along, self.gone, self.places[:, axis]) for axis in range(3)])
        share = 1.0 - np.exp(-dt / ROUND_S)
        self.rounded[0] += (place - self.rounded[0]) * share
        self.rounded[1] += (self.rounded[0] - self.rounded[1]) * share
        end = self.taken + self.rounded[1]
        back = smooth((time - self.lets_go) / REACH_S)
        return end + (RESTS - end) * back, along / self.gone[-1]

    def act(self, model: mujoco.MjModel, data: mujoco.MjData, tcp: str) -> None:
        """Moves their hand and the robot's for one step."""
        hand, led, time, dt = data.body("person_hand"), data.body(tcp), data.time, model.opt.timestep
        wanted, share = self.wanted(time, dt, led.xpos)
        shakes = self.tremor * np.sin(2.0 * np.pi * TREMOR_HZ * time + np.arange(3))
        dof = model.joint("person_0").dofadr[0]
        speed = data.qvel[dof : dof + 3]
        velocity, self.before = (wanted - self.before) / dt, wanted
        pull = (wanted + shakes - hand.xpos) * self.stiffness + (velocity - speed) * self.damping
        pull *= min(1.0, STRENGTH_N / max(float(np.linalg.norm(pull)), 1e-9))
        data.qfrc_applied[dof : dof + 3] = pull
        data.xfrc_applied[led.id] = 0.0
        if not self.begins + REACH_S <= time < self.lets_go:
            self.grip, self.force_n, self.behind_m = None, 0.0, 0.0
            return
        rotation = led.xmat.reshape(3, 3)
        if self.grip is None:
            self.grip = (rotation.T @ (hand.xpos - led.xpos), rotation.copy())
        arm = rotation @ self.grip[0]
        moving = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, led.id, moving, 0)
        closing = speed - (moving[3:] + np.cross(moving[:3], arm))
        force = (hand.xpos - led.xpos - arm) * GRIP_N_M + closing * 2.0 * DAMPED * np.sqrt(GRIP_N_M * self.mass)
        missing = rotation_vector(rotation_matrix(self.turn * share) @ self.grip[1] @ rotation.T)
        torque = missing * self.wrist - moving[:3] * 2.0 * DAMPED * np.sqrt(self.wrist * TURNED_KGM2)
        data.qfrc_applied[dof : dof + 3] -= force
        # Forces of the outside act at a body's centre of mass.
        data.xfrc_applied[led.id] = [*force, *(torque + np.cross(led.xpos + arm - led.xipos, force))]
        self.force_n, self.behind_m = float(np.linalg.norm(force)), float(np.linalg.norm(wanted - hand.xpos))

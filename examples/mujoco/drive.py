"""A robot of Armarium in MuJoCo: a driver below Armarium's guard, over Zenoh.

    pip install ./python mujoco pyyaml
    python examples/mujoco/drive.py robots/armar3/robot.yaml --listen tcp/127.0.0.1:7447 --sponge right_arm
    armarium run examples/mujoco/wipe.yaml --driver mujoco/armar3 --connect tcp/127.0.0.1:7447

The robot is that of the robot file, with the URDF's masses, limits and efforts. Every joint has a position servo; weight and
Coriolis forces are compensated, as robots do, and the wrist sensors feel what is beyond them. There is a table, and if asked for a
soft tool under a palm; or the table and the objects of a world file, and where these are is told to Armarium's cameras. Charts and
skills know nothing of all that.

Not here: platforms, contacts of the robot with itself (Armarium's guard keeps its bodies apart), DAE meshes.
"""

from __future__ import annotations

import argparse
import math
import re
import signal
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import armarium
import mujoco
import numpy as np
import yaml
from person import Person

STEP_S = 0.001
SERVO_RAD_S = 120.0  # bandwidth of the servos; critically damped
ROTOR = 0.2  # reflected inertia of a motor, kg m^2 (kg)
NOISE_N, NOISE_NM = 0.05, 0.002  # of the wrist sensors; a reading that repeats to the bit counts as a broken sensor
# The tool: pads on springs under the palm, so that it lies on a tilted table.
TOOL_SIZE, TOOL_STIFFNESS, TOOL_MASS, TOOL_TRAVEL = (0.04, 0.10, 0.07), 2000.0, 0.15, 0.02
PADS = (3, 2)
# Pads with which two hands press on a load: plates on springs.
PAD_MASS, PAD_DAMPED = 0.05, 0.2
# Whom a shape touches: the robot what is around it, and not itself; objects touch everything.
ROBOT, AROUND, LOOSE = (1, 2), (2, 1), (3, 3)
PRESSED, PAD = (4, 2), (0, 4)  # objects that pads press, and touch nothing else of the robot
OBJECT_FRICTION = 0.8
OBJECT_S = 0.01  # time constant of contacts of objects
TOLD_EVERY = 10  # samples, of which one tells where objects are

UNITS = {"": 1.0, "rad": 1.0, "m": 1.0, "deg": math.pi / 180, "mm": 1e-3, "cm": 1e-2, "kg": 1.0, "g": 1e-3}


def number(value: Any) -> float:
    """A number of a robot or world file: `0.3`, `80 deg`, `0.05 m`."""
    if isinstance(value, (int, float)):
        return float(value)
    found = re.fullmatch(r"\s*([-+0-9.eE]+)\s*([a-z]*)\s*", str(value))
    if found is None or found[2] not in UNITS:
        raise SystemExit(f"`{value}` is no angle, length or mass")
    return float(found[1]) * UNITS[found[2]]


class RobotFile:
    """What the driver needs of a robot file and its URDF."""

    def __init__(self, path: Path) -> None:
        self.file = yaml.safe_load(path.read_text())
        if self.file.get("platform", {}).get("kind", "none") != "none":
            raise SystemExit(f"{path}: robots on platforms are not simulated here")
        self.name = self.file["robot"]
        self.urdf = (path.parent / self.file["description"]).resolve()
        root = ElementTree.parse(self.urdf).getroot()
        self.efforts: dict[str, float] = {}
        for joint in root.findall("joint"):
            if joint.get("type") in ("revolute", "continuous", "prismatic") and joint.find("mimic") is None:
                limit = joint.find("limit")
                effort = float(limit.get("effort", 0.0)) if limit is not None else 0.0
                self.efforts[str(joint.get("name"))] = effort
        self.joints = list(self.efforts)
        self.wrenches = {name: wrench["frame"] for name, wrench in self.file.get("wrenches", {}).items()}

    def press_frames(self) -> list[tuple[str, str, np.ndarray, np.ndarray]]:
        """The hands that have a face to press with: the hand's name, the TCP, and the face's place and turn there."""
        found = []
        for group in self.file.get("groups", {}).values():
            press = self.file.get("hands", {}).get(group.get("hand"), {}).get("press_in_tcp")
            if press and "tcp" in group:
                quat = np.zeros(4)
                # URDF's and ROS's order: about the fixed x, y and z.
                mujoco.mju_euler2Quat(quat, [math.radians(number(angle)) for angle in press.get("rpy_deg", [0, 0, 0])], "XYZ")
                found.append((group["hand"], group["tcp"], np.array([number(v) for v in press["position"]]), quat))
        return found

    def posture(self, name: str | None) -> dict[str, float]:
        """The positions of a posture; joints that it does not name are at 0."""
        postures = self.file.get("postures", {})
        return {joint: number(value) for joint, value in postures.get(name, {}).items()}

    def tool_frame(self, arm: str) -> tuple[str, np.ndarray]:
        """The TCP of an arm, and where its hand holds something, in that frame."""
        group = self.file.get("groups", {}).get(arm)
        if group is None or "tcp" not in group:
            raise SystemExit(f"`{arm}` is no arm of {self.name}")
        hand = self.file.get("hands", {}).get(group.get("hand"), {})
        return group["tcp"], np.array(hand.get("grasp_in_tcp", {}).get("position", [0.0, 0.0, 0.0]), float)


def specified(robot: RobotFile, world: argparse.Namespace) -> mujoco.MjSpec:
    """The robot with servos and sensors, the table, the tool."""
    # Frames without mass, such as TCPs, are kept.
    options = '<mujoco><compiler fusestatic="false" discardvisual="false" strippath="false"/></mujoco>'
    text = re.sub(r"(<robot\b[^>]*>)", r"\1" + options, robot.urdf.read_text(), count=1)
    spec = mujoco.MjSpec.from_string(text)
    spec.modelfiledir = str(robot.urdf.parent)
    spec.option.timestep = STEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for geom in spec.geoms:
        if geom.contype:
            geom.contype, geom.conaffinity = ROBOT
    for joint in spec.joints:
        joint.armature = ROTOR
    for name, effort in robot.efforts.items():
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        # The gains follow when the inertia is known.
        servo.set_to_position(kp=1.0, kv=1.0)
        if effort > 0.0:
            servo.forcelimited, servo.forcerange = True, [-effort, effort]
    for name, frame in robot.wrenches.items():
        spec.body(frame).add_site(name=name)
        for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
            spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=name)
    add_table(spec, world)
    for press in robot.press_frames() if world.pads else []:
        add_pad(spec, world.pads, press)
    for thing in world.objects:
        add_object(spec, world, thing)
    if world.objects:
        # What is held by friction does not creep.
        spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
    if world.person:
        world.person.add(spec)
    if world.sponge:
        add_tool(spec, *robot.tool_frame(world.sponge), friction=world.friction)
    return spec


def tilted(world: argparse.Namespace) -> tuple[np.ndarray, np.ndarray]:
    """How the table is turned, and its normal."""
    roll, pitch = (math.radians(angle) for angle in world.tilt)
    turn, normal = np.zeros(4), np.zeros(3)
    mujoco.mju_euler2Quat(turn, [roll, pitch, 0.0], "XYZ")
    mujoco.mju_rotVecQuat(normal, [0.0, 0.0, 1.0], turn)
    return turn, normal


def add_object(spec: mujoco.MjSpec, world: argparse.Namespace, thing: dict[str, Any]) -> None:
    """A loose box of a world file on the table; what is left out is that of the file's default."""
    turn, normal = tilted(world)
    size = np.array([number(edge) for edge in thing.get("size", [0.10, 0.07, 0.04])])
    x, y = (number(value) for value in thing.get("at", [0.35, 0.50]))
    dx, dy = x - world.center[0], y - world.center[1]
    surface = np.array([x, y, world.height - (normal[0] * dx + normal[1] * dy) / normal[2]])
    yaw, pose = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(yaw, [0.0, 0.0, 1.0], math.radians(number(thing.get("yaw_deg", 20.0))))
    mujoco.mju_mulQuat(pose, turn, yaw)
    body = spec.worldbody.add_body(name=thing["name"], pos=surface + normal * size[2] / 2, quat=pose)
    body.add_freejoint()
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=size / 2,
        mass=number(thing.get("mass", 0.15)),
        friction=[OBJECT_FRICTION, 0.005, 0.0001],
        condim=4,
        priority=1,
        solref=[OBJECT_S, 1.0],
        contype=(PRESSED if world.pads else LOOSE)[0],
        conaffinity=(PRESSED if world.pads else LOOSE)[1],
    )


def add_table(spec: mujoco.MjSpec, world: argparse.Namespace) -> None:
    """A table whose top is at a height in its middle, tilted about x and y."""
    thick = 0.02
    turn, normal = tilted(world)
    middle = np.array([*world.center, world.height]) - normal * thick / 2
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[world.size[0] / 2, world.size[1] / 2, thick / 2],
        pos=middle,
        quat=turn,
        friction=[world.friction, 0.005, 0.0001],
        contype=AROUND[0],
        conaffinity=AROUND[1],
    )


def add_tool(spec: mujoco.MjSpec, tcp: str, held: np.ndarray, friction: float) -> None:
    """A tool whose middle is where the hand holds things: pads that give way along the palm's normal, x of the TCP."""
    depth, length, width = TOOL_SIZE
    radius = 0.005
    count = PADS[0] * PADS[1]
    damping = 1.2 * math.sqrt(TOOL_STIFFNESS * TOOL_MASS) / count
    for place in np.ndindex(*PADS):
        along, across = ((i + 0.5) / n - 0.5 for i, n in zip(place, PADS, strict=True))
        offset = np.array([depth / 2 - radius, along * length, across * width])
        pad = spec.body(tcp).add_body(pos=held + offset)
        pad.add_joint(
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[-1.0, 0.0, 0.0],
            stiffness=[TOOL_STIFFNESS / count],
            damping=[damping],
            limited=True,
            range=[-0.001, TOOL_TRAVEL],
        )
        pad.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[radius, 0.0, 0.0],
            mass=TOOL_MASS / count,
            friction=[friction, 0.005, 0.0001],
            contype=ROBOT[0],
            conaffinity=ROBOT[1],
        )


def add_pad(spec: mujoco.MjSpec, pads: dict[str, Any], press: tuple[str, str, np.ndarray, np.ndarray]) -> None:
    """A plate that gives way along its normal, x of the face with which a hand presses. Objects touch no other part of the hands."""
    hand, tcp, place, turn = press
    thick, half = number(pads.get("thickness", 0.03)), [number(edge) for edge in pads.get("half", [0.08, 0.09])]
    stiffness = number(pads.get("stiffness", 6000.0))
    pad = spec.body(tcp).add_body(name=f"pad_{hand}", pos=place, quat=turn)
    pad.add_joint(
        name=f"pad_{hand}",
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[-1.0, 0.0, 0.0],
        stiffness=[stiffness],
        damping=[2.0 * PAD_DAMPED * math.sqrt(stiffness * 1.0)],
        limited=True,
        range=[-0.001, thick],
    )
    pad.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[-thick / 2, 0.0, 0.0],
        size=[thick / 2, *half],
        mass=PAD_MASS,
        friction=[number(pads.get("friction", 0.9)), 0.005, 0.0001],
        condim=4,
        priority=2,
        contype=PAD[0],
        conaffinity=PAD[1],
    )


class MujocoRobot(armarium.Driver):
    """A robot in MuJoCo. In lockstep time passes in `apply`, else in `sample`."""

    def __init__(self, robot: RobotFile, world: argparse.Namespace) -> None:
        super().__init__(
            world.agent,
            world.name or robot.name,
            joints=robot.joints,
            wrenches=list(robot.wrenches),
            rate_hz=1.0 / STEP_S,
            clock=world.clock,
            bodies=[thing["name"] for thing in world.objects],
        )
        self.model = specified(robot, world).compile()
        self.data = mujoco.MjData(self.model)
        joints = [self.model.joint(name) for name in robot.joints]
        self.at = np.array([joint.qposadr[0] for joint in joints])
        self.dof = np.array([joint.dofadr[0] for joint in joints])
        self.random = np.random.default_rng(world.seed)
        for name, position in robot.posture(robot.file.get("start")).items():
            self.data.qpos[self.model.joint(name).qposadr[0]] = position
        mujoco.mj_forward(self.model, self.data)
        self._tune()
        self.held = self.data.qpos[self.at].copy()
        self.holds = True
        self._command(self.held, np.zeros(len(self.held)))
        self.person, self.led = world.person, robot.tool_frame(world.lead)[0] if world.lead else ""
        self.pads = [f"pad_{hand}" for hand, *_ in robot.press_frames()] if world.pads else []
        self.truth = world.truth.open("w") if world.truth else None
        self.samples = 0

    def _tune(self) -> None:
        """Servos with one bandwidth, by the inertia that each joint moves in the posture of the start."""
        inertia = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, inertia)
        moved = np.diag(inertia)[self.dof]
        self.stiffness, self.damping = moved * SERVO_RAD_S**2, 2.0 * moved * SERVO_RAD_S
        self.model.actuator_gainprm[:, 0] = self.stiffness
        self.model.actuator_biasprm[:, 1] = -self.stiffness
        self.model.actuator_biasprm[:, 2] = -self.damping

    def _command(self, position: np.ndarray, velocity: np.ndarray) -> None:
        # The servo damps the velocity towards 0; this makes it damp towards the one that is wanted.
        self.data.ctrl[:] = position + velocity * self.damping / self.stiffness

    def _step(self) -> None:
        self.data.qfrc_applied[self.dof] = self.data.qfrc_bias[self.dof]
        if self.person:
            self.person.act(self.model, self.data, self.led)
        mujoco.mj_step(self.model, self.data)
        if self.truth is not None:
            print(f"{self.data.time:.3f}", *(f"{value:.6f}" for value in self.true()), sep=",", file=self.truth)

    def true(self) -> list[float]:
        """What `--truth` writes of a step."""
        if self.person:
            return [self.person.force_n, self.person.behind_m, *self.data.body(self.led).xpos]
        if self.pads:
            pressed = [self.data.joint(pad).qpos[0] * self.model.joint(pad).stiffness[0] for pad in self.pads]
            return [*pressed, *(value for name in self.bodies for part in self.pose(name) for value in part)]
        return [self.pressing()]

    def pressing(self) -> float:
        """The normal force on the table, N, as it truly is."""
        table, force, total = self.model.geom("table").id, np.zeros(6), 0.0
        for i in range(self.data.ncon):
            if table in self.data.contact[i].geom:
                mujoco.mj_contactForce(self.model, self.data, i, force)
                total += force[0]
        return total

    def sample(self) -> armarium.Sample:
        if self.clock == "realtime":
            self._step()
        # MuJoCo gives what the sensor exerts on the hand.
        felt = -self.data.sensordata.reshape(-1, 6)
        noise = self.random.normal(0.0, [NOISE_N] * 3 + [NOISE_NM] * 3, felt.shape)
        stamp_ns = round(self.data.time * 1e9)
        told = {name: self.pose(name) for name in self.bodies} if self.samples % TOLD_EVERY == 0 else {}
        self.samples += 1
        return armarium.Sample(stamp_ns, self.data.qpos[self.at], self.data.qvel[self.dof], felt + noise, told)

    def pose(self, body: str) -> tuple[list[float], list[float]]:
        """Where a body is in the world, in whose origin the robot stands."""
        placed = self.data.body(body)
        return placed.xpos.tolist(), np.roll(placed.xquat, -1).tolist()

    def apply(self, targets: armarium.Targets) -> None:
        self.holds = False
        self._command(np.array(targets.position), np.array(targets.velocity))
        if self.clock == "lockstep":
            self._step()

    def brake(self) -> None:
        if not self.holds:
            self.held, self.holds = self.data.qpos[self.at].copy(), True
        self._command(self.held, np.zeros(len(self.held)))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", type=Path, help="the robot file, robot.yaml")
    parser.add_argument("--agent", default="mujoco", help="whose driver it is")
    parser.add_argument("--name", help="its name; by default the robot's")
    parser.add_argument("--listen", action="append", default=[], metavar="ENDPOINT", help="tcp/127.0.0.1:7447")
    parser.add_argument("--connect", action="append", default=[], metavar="ENDPOINT")
    parser.add_argument("--clock", choices=["lockstep", "realtime"], default="lockstep")
    parser.add_argument("--world", type=Path, metavar="FILE", help="a world file, for its table and its objects")
    parser.add_argument("--sponge", metavar="ARM", help="puts a soft tool under the palm of an arm")
    parser.add_argument("--height", type=float, default=0.95, help="of the table's top in its middle, m")
    parser.add_argument("--center", type=float, nargs=2, default=[0.25, 0.60], help="of the table, m")
    parser.add_argument("--size", type=float, nargs=2, default=[1.0, 0.7], help="of the table, m")
    parser.add_argument("--tilt", type=float, nargs=2, default=[1.0, -1.5], help="about x and y, degrees")
    parser.add_argument("--friction", type=float, default=0.5)
    parser.add_argument("--truth", type=Path, metavar="FILE", help="writes the truth of each step: time (s), force on the table (N)")
    parser.add_argument("--lead", metavar="ARM", help="a person takes the hand of an arm and leads it; then the truth is their force (N), how far their hand is from where they want it (m), and where the TCP is (m)")
    parser.add_argument("--seed", type=int, default=1, help="of the sensors' noise, and of what a person does")
    given = parser.parse_args()
    given.objects, given.pads = [], None
    given.person = Person(given.seed) if given.lead else None
    if given.world:
        placed = yaml.safe_load(given.world.read_text())
        table, given.pads = placed.get("table", {}), placed.get("robot", {}).get("pads")
        given.objects = placed.get("objects", [{"name": "sponge"}]) + placed.get("bodies", [])
        given.height = number(table.get("height", 0.95))
        given.center = [number(value) for value in table.get("center", [0.25, 0.60])]
        given.size = [number(value) for value in table.get("size", [1.0, 0.7])]
        given.tilt = [number(value) for value in table.get("tilt_deg", [1.0, -1.5])]
        given.friction = number(table.get("friction", 0.5))
    return given


def main() -> None:
    world = arguments()
    robot = RobotFile(world.robot)
    driver = MujocoRobot(robot, world)
    for ending in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ending, lambda *_: driver.stop())

    def tell() -> None:
        for name in driver.bodies:
            print(f"{name} is at", *(f"{value:.4f}" for value in driver.pose(name)[0]), flush=True)

    def ready() -> None:
        print(f"{driver.agent}/{driver.name} is ready", flush=True)
        tell()

    driver.serve(listen=world.listen, connect=world.connect, ready=ready)
    tell()
    if driver.truth is not None:
        driver.truth.close()


if __name__ == "__main__":
    main()

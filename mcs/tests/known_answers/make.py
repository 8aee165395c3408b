"""Writes known_answers.csv: kinematics and dynamics by Pinocchio (package `pin` 4.1.0, Python 3.11).

    pip install pin==4.1.0 numpy && python make.py > known_answers.csv

The arms of `configs/models` are built here anew, from the tables that those files cite, and the two URDF files beside
this one are read by a few lines of their own. States are random with a fixed seed.
A line: model, options, what was asked, the numbers that went in, the numbers that came out (by rows).
"""

import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin

HERE = Path(__file__).parent
RAD = np.pi / 180
SE3 = pin.SE3


def rot(axis, angle):
    return SE3(pin.AngleAxis(angle, np.array(axis, float)).matrix(), np.zeros(3))


def shift(x, y, z):
    return SE3(np.eye(3), np.array([x, y, z], float))


class Chain:
    """A tree that is built joint by joint; `at` is the place of the next joint in the frame of the last."""

    def __init__(self):
        self.model = pin.Model()
        self.tips = {}
        self.armature = []

    def joint(self, parent, placement, slides, name):
        kind = pin.JointModelPZ() if slides else pin.JointModelRZ()
        return self.model.addJoint(parent, kind, placement, name)

    def body(self, joint, placement, mass, com, inertia):
        inertia = pin.Inertia(float(mass), np.array(com, float), np.array(inertia, float))
        self.model.appendBodyToJoint(joint, inertia, placement)

    def rows(self, parent, at, rows, prefix):
        """Denavit-Hartenberg rows (type, theta0, d, a, alpha, mass, com, inertia, armature); the last joint and the rest."""
        joint = parent
        for index, (kind, theta, d, a, alpha, mass, com, inertia, armature) in enumerate(rows):
            joint = self.joint(joint, at * rot([0, 0, 1], theta * RAD), kind == "P", f"{prefix}{index}")
            at = shift(0, 0, d) * shift(a, 0, 0) * rot([1, 0, 0], alpha * RAD)
            self.body(joint, at, mass, com, np.diag(inertia))
            self.armature.append(armature)
        return joint, at


def puma(a2=0.4318, a3=0.0203, d1=0.67183, d3=0.15005, d4=0.4318):
    gears = [62.6111, 107.815, 53.7063, 76.0364, 71.923, 76.686]
    rotors = [200e-6] * 3 + [33e-6] * 3
    arm = [jm * g * g for jm, g in zip(rotors, gears)]
    return [
        ("R", 0, d1, 0, 90, 0, [0, 0, 0], [0, 0.35, 0], arm[0]),
        ("R", 0, 0, a2, 0, 17.4, [-0.3638, 0.006, 0.2275], [0.13, 0.524, 0.539], arm[1]),
        ("R", 0, d3, a3, -90, 4.8, [-0.0203, -0.0141, 0.070], [0.066, 0.086, 0.0125], arm[2]),
        ("R", 0, d4, 0, 90, 0.82, [0, 0.019, 0], [1.8e-3, 1.3e-3, 1.8e-3], arm[3]),
        ("R", 0, 0, 0, -90, 0.34, [0, 0, 0], [0.3e-3, 0.4e-3, 0.3e-3], arm[4]),
        ("R", 0, 0, 0, 0, 0.09, [0, 0, 0.032], [0.15e-3, 0.15e-3, 0.04e-3], arm[5]),
    ]


CART = [
    ("P", 90, 0, 0, -90, 150, [0, 0, 0.15], [6, 6, 6], 0),
    ("R", -90, 0.40, 0, -90, 60, [0, 0.10, 0], [2.0, 1.5, 2.0], 0),
    ("R", 0, 0, 0, 90, 40, [0, 0, 0.05], [1.2, 1.2, 1.0], 0),
]
TRACK = rot([0, 1, 0], 90 * RAD)


def built(name):
    chain = Chain()
    if name in ("puma560", "puma600"):
        rows = puma() if name == "puma560" else puma(0.432, 0, 0.660, 0.149, 0.432)
        chain.tips[""] = chain.rows(0, SE3.Identity(), rows, "j")
        return chain
    if name == "transporter":
        chain.tips[""] = chain.rows(0, TRACK, CART, "c")
        return chain
    sides = [("", 0.0)] if name == "testbed9" else [("left", 0.0), ("right", 1.2)]
    for side, y in sides:
        joint, at = chain.rows(0, shift(0, y, 0) * TRACK, CART, f"{side}c")
        chain.tips[side] = chain.rows(joint, at * shift(0, 0, 0.10), puma(), f"{side}j")
    return chain


def numbers(node, key, default):
    return [float(word) for word in node.get(key, default).split()] if node is not None else [float(w) for w in default.split()]


def origin(node):
    at = node.find("origin") if node is not None else None
    return SE3(pin.rpy.rpyToMatrix(np.array(numbers(at, "rpy", "0 0 0"))), np.array(numbers(at, "xyz", "0 0 0")))


def urdf(file, base, tip):
    """The joints between two links, which may go up before they go down."""
    robot = ET.parse(HERE / file).getroot()
    carrier = {joint.find("child").get("link"): joint for joint in robot.findall("joint")}
    links = {link.get("name"): link for link in robot.findall("link")}

    def up(link):
        way = []
        while link in carrier:
            way.append(carrier[link])
            link = carrier[link].find("parent").get("link")
        return way

    ups, downs = up(base), up(tip)
    while ups and downs and ups[-1] is downs[-1]:
        ups.pop(), downs.pop()
    chain = Chain()
    last, at = 0, SE3.Identity()
    for joint, upwards in [(j, True) for j in ups] + [(j, False) for j in reversed(downs)]:
        place = origin(joint)
        link = joint.find("parent" if upwards else "child").get("link")
        if not upwards:
            at = at * place
        if joint.get("type") != "fixed":
            axis = np.array(numbers(joint.find("axis"), "xyz", "1 0 0"))
            axis = axis / np.linalg.norm(axis) * (-1 if upwards else 1)
            turn = SE3(pin.Quaternion.FromTwoVectors(np.array([0.0, 0, 1]), axis).matrix(), np.zeros(3))
            last = chain.joint(last, at * turn, joint.get("type") == "prismatic", joint.get("name"))
            at = turn.inverse()
        if upwards:
            at = at * place.inverse()
        inertial = links[link].find("inertial")
        if inertial is not None and last:
            i = inertial.find("inertia")
            xx, xy, xz, yy, yz, zz = (float(i.get(k)) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
            tensor = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
            chain.body(last, at * origin(inertial), inertial.find("mass").get("value"), [0, 0, 0], tensor)
        chain.armature = [0.0] * chain.model.nv
    chain.tips[""] = (last, at)
    return chain


def answers(name, options, chain, rng, states, rotor):
    model = chain.model
    model.gravity.linear = np.array([0, 0, -9.81])
    model.armature = np.array(chain.armature) if rotor else np.zeros(model.nv)
    data = model.createData()
    n = model.nv
    for _ in range(states):
        q, qd, qdd, tau = (rng.uniform(-scale, scale, n) for scale in (1.5, 1.0, 2.0, 20.0))
        for side, (joint, at) in chain.tips.items():
            said = options + (f" -tip {side}" if side else "")
            pin.forwardKinematics(model, data, q)
            pose = data.oMi[joint] * at
            yield name, said, "fkine", [q], pose.homogeneous
            frame = pin.Frame("tip", joint, 0, at, pin.FrameType.OP_FRAME)
            copy = model.copy()
            tip = copy.addFrame(frame, False)
            yield name, said, "jacobian", [q], pin.computeFrameJacobian(copy, copy.createData(), q, tip, pin.LOCAL_WORLD_ALIGNED)
            moving = copy.createData()
            pin.forwardKinematics(copy, moving, q, qd, np.zeros(n))
            bias = pin.getFrameClassicalAcceleration(copy, moving, tip, pin.LOCAL_WORLD_ALIGNED)
            yield name, said, "bias", [q, qd], bias.vector
        yield name, options, "gravity", [q], pin.computeGeneralizedGravity(model, data, q)
        yield name, options, "rne", [q, qd, qdd], pin.rnea(model, data, q, qd, qdd)
        mass = pin.crba(model, data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        yield name, options, "inertia", [q], mass
        yield name, options, "fdyn", [q, qd, tau], pin.aba(model, data, q, qd, tau)


def main():
    rng = np.random.default_rng(19)
    rows = []
    for name in ("puma560", "puma600", "transporter", "testbed9", "testbed18"):
        rows += answers(name, "", built(name), rng, 2, False)
    rows += answers("puma560", "-rotor", built("puma560"), rng, 2, True)
    for file, base, tip in [
        ("six_axes.urdf", "foot", "wrist_3"),
        ("six_axes.urdf", "world", "tool"),
        ("six_axes.urdf", "wrist_3", "foot"),
        ("two_arms.urdf", "base", "left_hand"),
        ("two_arms.urdf", "left_hand", "right_hand"),
    ]:
        rows += answers(file, f"-base {base} -tip {tip}", urdf(file, base, tip), rng, 1, False)
    write = sys.stdout.write
    write("model,options,request,in,out\n")
    for name, options, what, given, found in rows:
        given = " ".join(repr(float(x)) for x in np.concatenate(given))
        found = " ".join(repr(float(x)) for x in np.asarray(found).ravel())
        write(f"{name},{options.strip()},{what},{given},{found}\n")


main()

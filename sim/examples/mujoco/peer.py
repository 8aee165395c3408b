"""An arm in MuJoCo for a control layer in another process: a peer of the channel driver `mcs.remote` (docs/remote.md).

    python peer.py arm.urdf udp:127.0.0.1:4560 --start 0 0.785 -1.571 0 0.785 0

The page tells how the URDF is written, too. Needs the package `mujoco`. Each command takes the world on by the period that it
names; positions are read back without noise. Brakes are dry friction of 1.5 times the drive's largest torque.
"""
import argparse
import os
import socket
import struct
import time
import xml.etree.ElementTree as ElementTree
import zlib

import mujoco

FRAME = struct.Struct("<4s4B2I3Q4I32s64d")
SIZE = FRAME.size + 4
COMMAND, STATE, TORQUE = 1, 2, 10
BRAKED, RELEASED, FINE, LATE, REFUSED = 1, 2, 0, 1, 2
STEP = 1.5e-3  # s, at most
STILL = 1e-3  # rad/s or m/s: brakes hold what is slower


class Arm:
    """The engine with the arm of a URDF."""

    def __init__(self, urdf, start, friction):
        robot = ElementTree.parse(urdf).getroot()
        self.model = model = mujoco.MjModel.from_xml_string(ElementTree.tostring(robot, "unicode"))
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.data = mujoco.MjData(model)
        limits = {joint.get("name"): joint.find("limit") for joint in robot.findall("joint")}
        self.effort = [float(limits[model.joint(index).name].get("effort")) for index in range(model.nv)]
        for drive in robot.findall("transmission"):  # MuJoCo reads no rotors from a URDF
            gear, inertia = (float(drive.find(f"actuator/{name}").text) for name in ("mechanicalReduction", "rotorInertia"))
            model.dof_armature[model.joint(drive.find("joint").get("name")).dofadr] = inertia * gear * gear
        model.dof_solref[:], model.dof_solimp[:, :2] = (2 * STEP, 1), 0.999  # what brakes hold does not creep
        if not friction:
            model.dof_damping[:] = model.dof_frictionloss[:] = 0
        self.dry = model.dof_frictionloss.copy()
        self.data.qpos[:] = start or [0] * model.nq
        self.braked = True

    def advance(self, torques, seconds):
        """Goes on under torques, or with the brakes on when there are none."""
        model, data = self.model, self.data
        self.braked = torques is None
        model.dof_frictionloss[:] = [1.5 * most for most in self.effort] if self.braked else self.dry
        data.qfrc_applied[:] = 0 if self.braked else [max(-m, min(m, t)) for t, m in zip(torques, self.effort)]
        if self.braked and abs(data.qvel).max() < STILL:
            data.qvel[:] = 0
            return
        steps = max(1, round(seconds / STEP + 0.4999))
        model.opt.timestep = seconds / steps
        for _ in range(steps):
            mujoco.mj_step(model, data)


class Peer:
    """The protocol: what is obeyed, and what is answered."""

    def __init__(self, arm):
        self.arm, self.slots = arm, arm.model.nv
        self.own = (time.monotonic_ns() ^ os.getpid() << 20) & 0xFFFFFFFF or 1
        self.driver = self.heard = self.sent = self.period = self.trouble = 0
        self.watchdog = None

    def take(self, data):
        """The answer to a datagram, or none."""
        if len(data) != SIZE or zlib.crc32(data[:-4]) != struct.unpack("<I", data[-4:])[0]:
            return None
        fields = FRAME.unpack(data[:-4])
        magic, version, kind, slots, power, session, receiver, sequence, _, _, period, watchdog, _, _, modes, *numbers = fields
        known = self.heard if session == self.driver else 0
        if (magic, version, kind, slots) != (b"mcsr", 1, COMMAND, self.slots) or sequence <= known:
            return None
        self.driver, self.heard, self.period, self.watchdog = session, sequence, period * 1e-9, watchdog * 1e-9
        torques = numbers[: 2 * slots : 2]
        sound = receiver == self.own and set(modes[:slots]) == {TORQUE} and all(t - t == 0 for t in torques)
        if power != RELEASED:
            self.trouble = FINE
        elif not sound:
            self.trouble = REFUSED
        power = BRAKED if power == RELEASED and self.trouble else power
        self.arm.advance(torques if power == RELEASED else None, self.period)
        return self.answer(power)

    def answer(self, power):
        self.sent += 1
        rows = [number for row in zip(self.arm.data.qpos, self.arm.data.qvel) for number in row]
        modes = bytes([TORQUE] * self.slots).ljust(32, b"\0")
        head = (b"mcsr", 1, STATE, self.slots, power, self.own, self.driver, self.sent, self.heard, time.monotonic_ns())
        rest = (int(self.period * 1e9), int(self.watchdog * 1e9), self.trouble, 0, modes)
        frame = FRAME.pack(*head, *rest, *rows, *[0.0] * (64 - len(rows)))
        return frame + struct.pack("<I", zlib.crc32(frame))

    def silent(self):
        """No command came for as long as the watchdog allows: the brakes engage."""
        self.trouble = self.trouble or LATE
        for _ in range(1000):
            self.arm.advance(None, self.period)
            if not self.arm.data.qvel.any():
                break


def listen(address):
    kind, _, rest = address.partition(":")
    if kind == "unix":
        own = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        if os.path.exists(rest):
            os.remove(rest)
        own.bind(rest)
    else:
        host, _, port = rest.rpartition(":")
        own = socket.socket(socket.AF_INET6 if "[" in host else socket.AF_INET, socket.SOCK_DGRAM)
        own.bind((host.strip("[]"), int(port)))
    return own


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="an arm in MuJoCo behind the protocol of mcs.remote")
    parser.add_argument("urdf")
    parser.add_argument("address", help="udp:HOST:PORT or unix:PATH")
    parser.add_argument("--start", type=float, nargs="*", help="joint positions, rad or m")
    parser.add_argument("--friction", action="store_true", help="the friction that the URDF gives")
    given = parser.parse_args()
    peer, own = Peer(Arm(given.urdf, given.start, given.friction)), listen(given.address)
    print(f"{peer.slots} slots in MuJoCo {mujoco.__version__}, at {given.address}", flush=True)
    last = time.monotonic()
    while True:
        own.settimeout(peer.watchdog and max(1e-3, last + peer.watchdog - time.monotonic()))
        try:
            data, driver = own.recvfrom(SIZE + 1)
        except TimeoutError:
            data = b""
        answer = peer.take(data)
        if answer:
            last = time.monotonic()
            try:
                own.sendto(answer, driver)
            except OSError:
                pass  # that driver is gone
        elif peer.watchdog and time.monotonic() - last > peer.watchdog:  # nothing else holds the watchdog off
            peer.silent()
            last = time.monotonic()

"""A node of ROS 2 by the Python packages eclipse-zenoh, rosbags and xxhash: peer.py PORT WORK [ARGUMENTS]. Prints JSON."""

import json
import struct
import sys
import time

import numpy
import xxhash
import zenoh
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
# rosbags knows no services; this hash is in the tables of others.
TRIGGER = "std_srvs::srv::dds_::Trigger_/RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
LIMIT = 60


def typed(message):
    package, _, name = message.split("/")
    return f"{package}::msg::dds_::{name}_/{STORE.hash_rihs01(message)}"


def session(mode, port):
    config = zenoh.Config()
    where = "listen" if mode == "router" else "connect"
    settings = {"mode": f'"{mode}"', "scouting/multicast/enabled": "false", f"{where}/endpoints": f'["tcp/127.0.0.1:{port}"]'}
    for key, value in settings.items():
        config.insert_json5(key, value)
    return zenoh.open(config)


class Node:
    """Declares what rmw_zenoh declares."""

    def __init__(self, session, name="peer"):
        self.session, self.name, self.count, self.kept = session, name, 0, []
        self.token("NN", "")

    def token(self, kind, rest):
        token = f"@ros2_lv/0/{self.session.zid()}/0/{self.count}/{kind}/%/%/{self.name}{rest}"
        self.count += 1
        self.kept.append(self.session.liveliness().declare_token(token))
        return token

    def endpoint(self, kind, name, of):
        token = self.token(kind, f"/{name.replace('/', '%')}/{of}/::,10:,:,:,,")
        return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")

    def subscribe(self, name, message, heard):
        self.endpoint("MS", name, typed(message))
        key = f"0{name}/{typed(message)}"

        def on(sample):
            sequence, stamp, length, gid = struct.unpack("<qqB16s", sample.attachment.to_bytes())
            assert length == 16
            heard(STORE.deserialize_cdr(sample.payload.to_bytes(), message), sequence, stamp, gid)

        self.kept.append(self.session.declare_subscriber(key, on))

    def publisher(self, name, message):
        gid = self.endpoint("MP", name, typed(message))
        publisher, count = self.session.declare_publisher(f"0{name}/{typed(message)}"), [0]

        def publish(body):
            count[0] += 1
            publisher.put(body, attachment=struct.pack("<qqB16s", count[0], time.time_ns(), 16, gid))

        until(lambda: publisher.matching_status.matching, f"a subscription of {name}")
        return publish

    def call(self, name, body=b"\x00\x01\x00\x00\x00"):
        gid = self.endpoint("SC", name, TRIGGER)
        attachment = struct.pack("<qqB16s", 7, time.time_ns(), 16, gid)
        target = zenoh.QueryTarget.ALL_COMPLETE
        replies = self.session.get(f"0{name}/{TRIGGER}", payload=body, attachment=attachment, target=target, timeout=20)
        for reply in replies:
            sequence, _, _, echoed = struct.unpack("<qqB16s", reply.ok.attachment.to_bytes())
            assert (sequence, echoed) == (7, gid), "the attachment of the request"
            data = reply.ok.payload.to_bytes()
            assert data[:4] == b"\x00\x01\x00\x00"
            (length,) = struct.unpack("<I", data[8:12])
            assert data[12 + length - 1] == 0 and len(data) == 12 + length
            return {"success": bool(data[4]), "message": data[12 : 12 + length - 1].decode()}
        return None


def until(done, what):
    for _ in range(LIMIT * 50):
        if done():
            return
        time.sleep(0.02)
    sys.exit(f"{what} did not come in {LIMIT} s")


def tokens(session):
    found = {}
    for reply in session.liveliness().get("@ros2_lv/0/**", timeout=5):
        chunks = str(reply.ok.key_expr).split("/")
        if chunks[2] != str(session.zid()):
            kind, name = chunks[5], chunks[9].replace("%", "/") if len(chunks) > 9 else chunks[8]
            found[f"{kind} {name}"] = chunks
    return found


def look(node):
    """Hears the topics until there was something on each of them."""
    wanted = {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/ceiling_west/image_raw": "sensor_msgs/msg/Image",
        "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    }
    if "lens" in sys.argv:
        wanted["/ceiling_west/camera_info"] = "sensor_msgs/msg/CameraInfo"
    heard = {name: [] for name in wanted}
    for name, message in wanted.items():
        node.subscribe(name, message, lambda *one, name=name: heard[name].append(one))
    until(lambda: all(len(all_) > 4 for all_ in heard.values()), f"{[name for name in heard if len(heard[name]) < 5]}")
    there = tokens(node.session)
    for name, message in wanted.items():
        chunks = there[f"MP {name}"]
        assert "/".join(chunks[10:12]) == typed(message), chunks
        assert chunks[12] == "::,10:,:,:,,", chunks
        # The GID is that of the token, and messages are counted.
        gid = xxhash.xxh3_128_intdigest("/".join(chunks).encode()).to_bytes(16, "little")
        numbers = [sequence for _, sequence, _, _ in heard[name]]
        assert all(one[3] == gid for one in heard[name]), name
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), name
        assert all(abs(one[2] - time.time_ns()) < 60e9 for one in heard[name]), name
    joints = heard["/joint_states"][-1][0]
    # One message for each task that shows something.
    frames = {t.child_frame_id: t for one in heard["/tf"] for t in one[0].transforms}.values()
    image, lens = heard["/ceiling_west/image_raw"][-1][0], heard.get("/ceiling_west/camera_info", [[None]])[-1][0]
    turns = [(t.transform.rotation.x, t.transform.rotation.y, t.transform.rotation.z, t.transform.rotation.w) for t in frames]
    return {
        "node": [name for name in there if name.startswith("NN")],
        "tokens": sorted(there),
        "joints": joints.name,
        "positions": joints.position.tolist(),
        "age_s": abs(joints.header.stamp.sec - time.time()),
        "frames": [[t.header.frame_id, t.child_frame_id] for t in frames],
        "norms": [float(numpy.linalg.norm(turn)) for turn in turns],
        "image": [image.width, image.height, image.step, len(image.data), image.encoding, float(numpy.max(image.data))],
        "lens": lens and [lens.width, lens.height, *lens.k.tolist(), *lens.p.tolist()],
        "said": {status.name: status.message for one in heard["/diagnostics"] for status in one[0].status},
    }


def trajectory(names, points):
    types = STORE.types
    stamp = types["builtin_interfaces/msg/Time"](0, 0)
    header = types["std_msgs/msg/Header"](stamp, "")
    none = numpy.array([])
    point = types["trajectory_msgs/msg/JointTrajectoryPoint"]
    start = types["builtin_interfaces/msg/Duration"](1, 0)
    points = [point(numpy.array(one, dtype=numpy.float64), none, none, none, start) for one in points]
    message = types["trajectory_msgs/msg/JointTrajectory"](header, names, points)
    return bytes(STORE.serialize_cdr(message, "trajectory_msgs/msg/JointTrajectory"))


class Watch:
    """What joints and diagnostics say now."""

    def __init__(self, node):
        self.joints, self.bridge = {}, {}
        node.subscribe("/joint_states", "sensor_msgs/msg/JointState", self.on_joints)
        node.subscribe("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", self.on_said)
        until(lambda: self.joints and self.bridge, "the state of the arm")

    def on_joints(self, message, *_):
        self.joints = dict(zip(message.name, message.position.tolist()))

    def on_said(self, message, *_):
        for status in message.status:
            if status.name.endswith("bridge to ROS 2"):
                self.bridge = {one.key: one.value for one in status.values}

    def told(self, key, text):
        until(lambda: text in self.bridge.get(key, ""), f"`{text}` at `{key}` in {self.bridge}")
        return self.bridge[key]


ARM = "/arm/joint_trajectory"


def move(node):
    """Has the arm pass two points, and tells where it is then."""
    watch = Watch(node)
    publish = node.publisher(ARM, "trajectory_msgs/msg/JointTrajectory")
    names = list(watch.joints)
    first = [watch.joints[name] for name in names]
    goal = [position + 0.2 for position in first]
    middle = [position + 0.1 for position in first]
    order = list(reversed(range(len(names))))
    publish(trajectory([names[at] for at in order], [[one[at] for at in order] for one in (middle, goal)]))
    told = watch.told(f"done {ARM}", "passed 2 points")
    off = lambda: max(abs(watch.joints[name] - want) for name, want in zip(names, goal))
    until(lambda: off() < 2e-3, f"the goal {goal}: {watch.joints}")
    watch.told(f"peers of {ARM}", "1")
    called = [node.call("/arm/status"), node.call("/arm/stop"), node.call("/arm/reset")]
    return {"told": told, "calls": called, "peers": watch.bridge["peers of " + ARM]}


def harm(node):
    """Sends what is no trajectory; the arm still passes one afterwards."""
    watch = Watch(node)
    name = "trajectory_msgs/msg/JointTrajectory"
    key = f"wrong {ARM}"
    publish = node.publisher(ARM, name)
    names = list(watch.joints)
    good = trajectory(names, [[watch.joints[one] for one in names]])
    told = []

    def wrong(text):
        told.append(watch.told(key, text))

    for length in (0, 3, 4, 20, len(good) - 1):
        publish(good[:length])
    wrong("cannot be read")
    # The number of names, then the length of the first of them.
    publish(good[:20] + b"\xff\xff\xff\xff" + good[24:])
    publish(good[:24] + b"\xff\xff\xff\x7f" + good[28:])
    publish(b"\x07\x07\x00\x00" + good[4:])
    wrong("its encoding is not CDR")
    publish(b"\x00\x01\x00\x00" + bytes(5_000_000))
    wrong("more than are taken")
    publish(trajectory(names[1:], [[0.0] * (len(names) - 1)]))
    wrong(f"nothing of joint `{names[0]}`")
    publish(trajectory(names, [[0.0]]))
    wrong("has 1 positions")
    publish(trajectory(names, [[float("nan")] * len(names)]))
    wrong("no number")
    publish(trajectory(names, [[100.0] * len(names)]))
    wrong("point 0 of 1")
    of = typed(name)
    node.session.put(f"0{ARM}/{of}", good)
    wrong("without what rmw_zenoh attaches")
    other = of.replace("RIHS01_1", "RIHS01_2")
    node.session.put(f"0{ARM}/{other}", good, attachment=bytes(33))
    wrong("of another type")
    node.endpoint("MP", ARM, typed("std_msgs/msg/String"))
    wrong("they exchange nothing")
    node.endpoint("MS", "/joint_states", "sensor_msgs::msg::dds_::JointState_/TypeHashNotSupported")
    told.append(watch.told("wrong /joint_states", "TypeHashNotSupported"))
    for token in ("@ros2_lv/0/x", "@ros2_lv/0/1/2/3/MP/%/%/n/%joint_states", "@ros2_lv/0/1/2/3/QQ/%/%/n/a/b/c/d"):
        node.kept.append(node.session.liveliness().declare_token(token))
    calls = [node.call("/arm/status", b"\x00"), node.call("/arm/status")]
    publish(good)
    return {"told": told, "calls": calls, "done": watch.told(f"done {ARM}", "passed 1 points")}


def refused(node):
    """Orders what may not be ordered."""
    watch = Watch(node)
    names = list(watch.joints)
    publish = node.publisher(ARM, "trajectory_msgs/msg/JointTrajectory")
    publish(trajectory(names, [[0.0] * len(names)]))
    return {"told": watch.told(f"wrong {ARM}", "allow_control"), "call": node.call("/arm/stop")}


def hear(node):
    """Hears joints three times."""
    heard = []
    node.subscribe("/joint_states", "sensor_msgs/msg/JointState", lambda *one: heard.append(one))
    until(lambda: len(heard) > 2, "joints")
    return {"joints": heard[-1][0].name}


work = sys.argv[2]
with session("router" if "as-router" in sys.argv else "peer", sys.argv[1]) as joined:
    print(json.dumps(globals()[work](Node(joined))), flush=True)

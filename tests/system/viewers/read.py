"""Reads a record as a stranger: with the Python packages mcap and mcap-protobuf-support. Prints what it found as JSON."""

import json
import math
import sys
from collections import Counter, defaultdict

import cv2
import numpy
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

decoded = Counter()
frames = set()
wanted = set()
joints = []
tool = []
spans = defaultdict(list)
images = {}
contrasts = []
with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, decoder_factories=[DecoderFactory()])
    for schema, channel, message in reader.iter_messages():
        topic = channel.topic
        if topic.startswith("/numbers/"):
            json.loads(message.data)
            decoded[topic] += 1
            continue
        if schema is None or schema.encoding != "protobuf":
            continue
        factory = DecoderFactory()
        one = factory.decoder_for(channel.message_encoding, schema)(message.data)
        decoded[topic] += 1
        if topic.startswith("/tf/"):
            places = {}
            for transform in one.transforms:
                assert transform.parent_frame_id == "world", transform
                frames.add(transform.child_frame_id)
                at = transform.translation
                turn = transform.rotation
                norm = math.sqrt(turn.x**2 + turn.y**2 + turn.z**2 + turn.w**2)
                assert abs(norm - 1) < 1e-6, transform
                places[transform.child_frame_id] = numpy.array([at.x, at.y, at.z])
            if topic == "/tf/state":
                # The planned path stands in the frame of the base, beside the arm.
                names = [transform.child_frame_id for transform in one.transforms]
                names = [name for name in names if "planned path" not in name]
                tool.append(places[names[-1]])
                for before, after in zip(names, names[1:]):
                    length = numpy.linalg.norm(places[after] - places[before])
                    spans[before, after].append(length)
        elif topic.startswith("/solids/"):
            wanted.update(entity.frame_id for entity in one.entities)
        elif topic == "/joints/state":
            joints = [joint.name for joint in one.joints]
            assert all(joint.HasField("position") for joint in one.joints), one
        elif topic.endswith("/image"):
            picture = cv2.imdecode(numpy.frombuffer(one.data, numpy.uint8), cv2.IMREAD_GRAYSCALE)
            assert picture is not None and one.format == "jpeg", topic
            images[topic, one.timestamp.seconds, one.timestamp.nanos] = picture
        elif topic.endswith("/marks"):
            stamp = one.timestamp
            picture = images.get((topic.replace("/marks", "/image"), stamp.seconds, stamp.nanos))
            if picture is None or len(one.circles) != 1:
                continue
            at = one.circles[0].position
            row, column = round(at.y), round(at.x)
            near = picture[max(0, row - 2) : row + 3, max(0, column - 2) : column + 3]
            around = picture[max(0, row - 14) : row + 15, max(0, column - 14) : column + 15]
            contrasts.append(float(near.max()) - float(numpy.median(around)))

print(json.dumps({
    "decoded": decoded,
    "joints": joints,
    "unplaced": len(wanted - frames),
    "link_spread_m": max(max(all_) - min(all_) for all_ in spans.values()),
    "moved_m": max(float(numpy.linalg.norm(at - tool[0])) for at in tool),
    "marks": len(contrasts),
    "least_contrast": min(contrasts, default=0),
}))

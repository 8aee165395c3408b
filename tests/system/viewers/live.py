"""Follows a running app as a stranger: by the Foxglove WebSocket protocol, with websocket-client. Prints what came as JSON.

Arguments: the address, and the certificate of the app's authority where it is encrypted."""

import base64
import json
import struct
import sys

import cv2
import numpy
import websocket
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory

# The certificate names the key, and no host.
encrypted = {"ca_certs": sys.argv[2], "check_hostname": False} if len(sys.argv) > 2 else None
socket = websocket.create_connection(sys.argv[1], subprotocols=["foxglove.sdk.v1"], timeout=30, sslopt=encrypted)
found = {"protocol": socket.getsubprotocol(), "transforms": 0, "joints": 0, "pictures": 0, "undecoded": 0}
decoders = {}
topics = {}
while found["transforms"] < 20 or found["pictures"] < 2 or found["joints"] == 0:
    message = socket.recv()
    if isinstance(message, str):
        told = json.loads(message)
        if told["op"] != "advertise":
            continue
        for channel in told["channels"]:
            if channel["encoding"] != "protobuf":
                continue
            data = base64.b64decode(channel["schema"])
            schema = Schema(id=channel["id"], name=channel["schemaName"], encoding="protobuf", data=data)
            decoders[channel["id"]] = DecoderFactory().decoder_for("protobuf", schema)
            topics[channel["id"]] = channel["topic"]
            wanted = {"op": "subscribe", "subscriptions": [{"id": channel["id"], "channelId": channel["id"]}]}
            socket.send(json.dumps(wanted))
        continue
    operation, subscription, _time = struct.unpack_from("<BIQ", message)
    if operation != 1:
        continue
    try:
        one = decoders[subscription](message[13:])
    except Exception:
        found["undecoded"] += 1
        continue
    topic = topics[subscription]
    if topic.startswith("/tf/"):
        found["transforms"] += 1
        assert all(transform.parent_frame_id == "world" for transform in one.transforms)
    elif topic.startswith("/joints/"):
        found["joints"] = len(one.joints)
    elif topic.endswith("/image"):
        picture = cv2.imdecode(numpy.frombuffer(one.data, numpy.uint8), cv2.IMREAD_GRAYSCALE)
        found["pictures"] += picture is not None
socket.close()
print(json.dumps(found))

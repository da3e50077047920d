"""What independent readers find in a bag of ROS 2: read_bag.py FOLDER

A line of JSON for each reader and topic: {"reader", "topic", "type", "messages", "sha256"}; the digest is that of
the sequences of bytes of all messages, one after the other. rosbags reads the folder, mcap-ros2-support its .mcap.
"""

import hashlib
import json
import pathlib
import sys

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

BYTES = ("events", "data")


def take(found, topic, kind, message):
    each = found.setdefault((topic, kind), [0, hashlib.sha256()])
    each[0] += 1
    for field in BYTES:
        value = getattr(message, field, 0)
        # One of a frame's is a number.
        if not isinstance(value, int):
            each[1].update(bytes(value))


def with_rosbags(folder):
    found = {}
    with AnyReader([folder], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            take(found, connection.topic, connection.msgtype, message)
    return found


def with_mcap(folder):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    found = {}
    for path in sorted(folder.glob("*.mcap")):
        with open(path, "rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
            for schema, channel, _, message in reader.iter_decoded_messages():
                take(found, channel.topic, schema.name, message)
    return found


def main():
    folder = pathlib.Path(sys.argv[1])
    for reader, read in (("rosbags", with_rosbags), ("mcap-ros2-support", with_mcap)):
        for (topic, kind), (messages, digest) in sorted(read(folder).items()):
            print(json.dumps({
                "reader": reader, "topic": topic, "type": kind, "messages": messages, "sha256": digest.hexdigest(),
            }))


if __name__ == "__main__":
    main()

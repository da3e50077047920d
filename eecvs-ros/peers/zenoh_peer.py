"""A node over Zenoh for tests, by zenoh-ros2-sdk: rmw_zenoh's convention, written by others, without ROS.

    FOLDER/venv/bin/python zenoh_peer.py PORT TYPE DEFINITION COUNT [TOPIC ...]

Connects to the router at a port of this computer, takes the messages of `/there`, reads them by their definition, a
.msg file, and publishes what it has read on `/back`. Ends after so many messages, or 45 seconds. Prints lines of
JSON: {"hash"} of the type, as it follows from the definition, {"ready"}, and at the end {"received", "topics":
{TOPIC: {"publishers" | "subscribers": [{"node", "type", "hash", "qos"}]}}}. The domain is ROS_DOMAIN_ID's.
"""

import json
import pathlib
import sys
import threading
import time

from rosbags.typesys import get_types_from_msg
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber, ZenohSession, get_topic_info
from zenoh_ros2_sdk.utils import get_type_hash

PARTS = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
}


def say(**fields):
    print(json.dumps(fields), flush=True)


def ends_of(topic, link):
    info = get_topic_info(topic, verbose=True, **link)
    ends = {"publishers": info.publishers, "subscribers": info.subscribers} if info else {}
    return {
        end: [
            {
                "node": f"{each.node_namespace.rstrip('/')}/{each.node_name}",
                "type": each.topic_type,
                "hash": each.type_hash,
                "qos": each.qos,
            }
            for each in all_of
        ]
        for end, all_of in ends.items()
    }


def main():
    port, kind, definition, count, *topics = sys.argv[1:]
    definition = pathlib.Path(definition).read_text(encoding="utf-8")
    link = {"router_ip": "127.0.0.1", "router_port": int(port)}
    for part, text in PARTS.items():
        ZenohSession.get_instance(**link).store.register(get_types_from_msg(text, part))
    kind_hash = get_type_hash(kind, msg_definition=definition, dependencies=PARTS)
    say(hash=kind_hash)

    ours = dict(msg_type=kind, msg_definition=definition, type_hash=kind_hash, node_name="peer", **link)
    # Reliable, volatile, the last 1000.
    publisher = ROS2Publisher(topic="/back", qos="::,1000:,:,:,,", **ours)
    received = 0
    done = threading.Event()

    def back(message):
        nonlocal received
        fields = {each: value for each, value in vars(message).items() if not each.startswith("__")}
        publisher.publish(**fields)
        received += 1
        if received == int(count):
            done.set()

    subscriber = ROS2Subscriber(topic="/there", callback=back, qos="::,1000:,:,:,,", **ours)
    say(ready=True)
    done.wait(45)

    # Who has just been met may not have told all of its ends yet: asked again, it has.
    for _ in range(50):
        seen = {topic: ends_of(topic, link) for topic in topics}
        others = [
            any(not end["node"].endswith("/peer") for all_of in ends.values() for end in all_of)
            for ends in seen.values()
        ]
        if all(others):
            break
        time.sleep(0.1)
    say(received=received, topics=seen)
    subscriber.close()
    publisher.close()
    ZenohSession.get_instance(**link).session.close()


if __name__ == "__main__":
    main()

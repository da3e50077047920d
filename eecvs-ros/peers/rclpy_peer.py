"""A node of genuine ROS 2 as the other end of a test, in the environment that setup.sh makes.

    rclpy_peer.py listen TYPE TOPIC --count N --seconds S
    rclpy_peer.py talk   TYPE TOPIC --count N --rate HZ --bytes B [--seconds S]
    rclpy_peer.py graph  --seconds S --until TOPIC...

What it sees, sends and finds it prints as lines of JSON; it ends by itself.
"""

import argparse
import hashlib
import json
import sys
import time

import rclpy
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from messages import cdr, fill, message_class

QOS = QoSProfile(
    reliability=QoSReliabilityPolicy.BEST_EFFORT,
    durability=QoSDurabilityPolicy.VOLATILE,
    history=QoSHistoryPolicy.KEEP_LAST,
    depth=1000,
)


def say(**fields):
    print(json.dumps(fields), flush=True)


def digest(message):
    """What both ends compare: every byte of every field."""
    return hashlib.sha256(cdr(message)).hexdigest()


def listen(node, arguments):
    kind = message_class(arguments.type)
    received = []

    def take(message):
        received.append(message)
        stamp = message.header.stamp
        say(
            seq=getattr(message, "seq", None),
            sha256=digest(message),
            stamp_ns=stamp.sec * 10**9 + stamp.nanosec,
            frame_id=message.header.frame_id,
        )

    node.create_subscription(kind, arguments.topic, take, QOS)
    end = time.monotonic() + arguments.seconds
    say(ready=True)
    while len(received) < arguments.count and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)
    say(received=len(received))


def talk(node, arguments):
    publisher = node.create_publisher(message_class(arguments.type), arguments.topic, QOS)
    end = time.monotonic() + arguments.seconds
    while publisher.get_subscription_count() == 0 and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.05)
    # The other end may have found this one a moment later.
    time.sleep(0.5)
    for number in range(arguments.count):
        message = fill(message_class(arguments.type)(), number, arguments.bytes)
        publisher.publish(message)
        say(seq=getattr(message, "seq", None), sha256=digest(message))
        time.sleep(1 / arguments.rate)
    # What is sent has left before the participant does.
    time.sleep(0.5)
    say(sent=arguments.count)


def endpoint(info):
    qos = info.qos_profile
    return {
        "node": f"{info.node_namespace.rstrip('/')}/{info.node_name}",
        "type": info.topic_type,
        "reliability": qos.reliability.name,
        "durability": qos.durability.name,
    }


def graph(node, arguments):
    end = time.monotonic() + arguments.seconds
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.2)
        seen = dict(node.get_topic_names_and_types())
        if all(topic in seen for topic in arguments.until):
            break
    # Nodes' names follow their topics.
    time.sleep(1)
    nodes = [
        f"{namespace.rstrip('/')}/{name}" for name, namespace in node.get_node_names_and_namespaces()
    ]
    topics = {
        topic: {
            "types": types,
            "publishers": [endpoint(info) for info in node.get_publishers_info_by_topic(topic)],
            "subscriptions": [endpoint(info) for info in node.get_subscriptions_info_by_topic(topic)],
        }
        for topic, types in node.get_topic_names_and_types()
    }
    say(nodes=sorted(nodes), topics=topics)


def main():
    parser = argparse.ArgumentParser()
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("listen", "talk"):
        command = commands.add_parser(name)
        command.add_argument("type")
        command.add_argument("topic")
        command.add_argument("--count", type=int, required=True)
        command.add_argument("--seconds", type=float, default=20)
        command.add_argument("--rate", type=float, default=100)
        command.add_argument("--bytes", type=int, default=1000)
    command = commands.add_parser("graph")
    command.add_argument("--seconds", type=float, default=20)
    command.add_argument("--until", nargs="*", default=[])
    arguments = parser.parse_args()
    rclpy.init()
    node = rclpy.create_node(f"peer_{arguments.command}")
    {"listen": listen, "talk": talk, "graph": graph}[arguments.command](node, arguments)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    sys.exit(main())

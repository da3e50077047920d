"""A genuine ROS 2 node for tests: rclpy with Fast DDS. Every subcommand ends by itself and prints lines of JSON.

    env.sh FOLDER python rclpy_peer.py listen event_camera_msgs/msg/EventPacket /events --count 200 --seconds 20
    env.sh FOLDER python rclpy_peer.py talk event_camera_msgs/msg/EventPacket /events --count 200 --rate 100
    env.sh FOLDER python rclpy_peer.py graph --seconds 5
    env.sh FOLDER python rclpy_peer.py parameters /event_camera/encode --names window_us --set window_us=5000
    env.sh FOLDER python rclpy_peer.py cdr event_camera_msgs/msg/EventPacket

listen  {"ready"}, a line for each message: {"received": i, "time_ns", "bytes", "cdr_sha256", "seq", "message"},
        and {"summary": {"received", "first", "last", "lost", "disordered"}}. `cdr_sha256` is of the message that
        was read, serialised again; `time_ns` is the host's time. Arrays of numbers are told by their
        length and sha256 in little endian. `lost` are the numbers, `seq`, that have not arrived though others
        before and behind them have.
talk    {"ready"}, {"matched"} once a subscriber is there (status 1 if none comes), {"sent": i, ...} as above,
        and {"summary": {"sent"}}. No field of a message is left at its default. `--set width=640` sets one, and
        `--file PATH` takes the bytes of the messages from a file, from its start to its end. With `--leave-out R
        --of N`, of every N messages the last R are never published.
graph   {"nodes", "topics", "services"} after some seconds, or once the topics of `--until` are there, as this
        node sees them, without this node.
parameters  {"listed", "values", "types", "described", "set": [{"successful", "reason"}], "atomically": {...}} of a
        node's parameters, by rclpy's client of them, as `ros2 param` uses it. A number with `.` is a double.
cdr     {"type", "hash", "messages": [{"cdr", "values"}]}: the serialisation in hexadecimal and all values of
        an empty message and of some whose strings differ in length, hence the padding. Makes the files of cdr/.

Where fields are padded, Fast CDR leaves what its memory held; here it is zeros.

The exit status is 0 where the peer worked, however much was received.
"""

import argparse
import array
import hashlib
import importlib
import json
import re
import sys
import time

SECOND = 1_000_000_000


def say(**fields):
    print(json.dumps(fields), flush=True)


def load(name):
    """The class of a type such as std_msgs/msg/Header."""
    package, kind, message = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), message)


def type_hash(name):
    from ament_index_python.packages import get_package_share_directory

    package, kind, message = name.split("/")
    with open(f"{get_package_share_directory(package)}/{kind}/{message}.json", encoding="utf-8") as file:
        return next(each["hash_string"] for each in json.load(file)["type_hashes"] if each["type_name"] == name)


# Messages whose content follows from an index.

# Numbers by their names in messages, as the module array has them.
TYPECODES = {"float": "f", "double": "d", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
             "uint32": "I", "int64": "q", "uint64": "Q"}
PLAUSIBLE = {
    "sec": lambda index: 1_700_000_000 + index // 1000,
    "nanosec": lambda index: index % 1000 * 1_000_000 + 123_456,
    "seq": lambda index: index,
    "height": lambda index: 720,
    "width": lambda index: 1280,
    "time_base": lambda index: 0x0001_0203_0405_0607 + index * 1000,
    "t0_us": lambda index: 0x0000_0203_0405_0607 + index * 33_333,
    "duration_us": lambda index: 33_333,
    "encoding": lambda index: "evt3",
    "operator_name": lambda index: "eecvs",
}


def elements(kind):
    """Type and number of the elements of an array; a sequence's number is None; no array has none."""
    found = re.fullmatch(r"sequence<(.+?)(?:, \d+)?>|(.+)\[(\d+)\]", kind)
    return (found[1] or found[2], found[3] and int(found[3])) if found else (None, None)


def size_of(kind):
    return array.array(TYPECODES[kind]).itemsize if kind in TYPECODES else 1


class Filler:
    """Fills the fields of a message, each with a value of its own."""

    def __init__(self, index, size, seed):
        self.index, self.size, self.seed, self.field = index, size, seed, 0

    def number(self, kind):
        self.field += 1
        mixed = ((self.index + 1) * 0x9E3779B97F4A7C15 + (self.field << 32 | self.seed) * 0xBF58476D1CE4E5B9) % 2**64
        if kind == "boolean":
            return (self.index + self.field + self.seed) % 4 != 0
        if kind in ("float", "double"):
            return (mixed >> 44) / 64 - 4096
        bits = size_of(kind) * 8
        value = mixed >> (64 - bits)
        return value if not kind.startswith("int") else value - 2 ** (bits - 1)

    def numbers(self, kind, count):
        self.field += 1
        if TYPECODES[kind] == "B":
            block = hashlib.sha256(f"{self.index} {self.field} {self.seed}".encode()).digest()
            return array.array("B", (block * (count // len(block) + 1))[:count])
        return array.array(TYPECODES[kind], (self.number(kind) for _ in range(count)))

    def value(self, name, kind):
        if name in PLAUSIBLE:
            self.field += 1
            return PLAUSIBLE[name](self.index)
        inner, count = elements(kind)
        if inner:
            if inner in TYPECODES:
                return self.numbers(inner, count or max(self.size // size_of(inner), 1))
            return [self.value("", inner) for _ in range(count or self.index % 3 + 1)]
        if "/" in kind:
            return self.message(load(kind.replace("/", "/msg/"))())
        if kind.startswith("string"):
            self.field += 1
            return f"{name or 'text'} {self.index} {self.field}" + "." * ((self.index + self.field) % 4)
        if kind == "octet":
            return bytes([self.number(kind)])
        return self.number(kind)

    def message(self, message):
        for name, kind in message.get_fields_and_field_types().items():
            setattr(message, name, self.value(name, kind))
        return message


def plain(value, whole):
    """A message as JSON has it; arrays of numbers whole, or their length and digest."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name), whole) for name in value.get_fields_and_field_types()}
    if hasattr(value, "tobytes"):
        if whole:
            return value.tolist()
        return {"length": len(value), "sha256": hashlib.sha256(value.tobytes()).hexdigest()}
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, (list, tuple)):
        return [plain(each, whole) for each in value]
    return value


def serialised(message):
    """The message as CDR, with zeros for padding."""
    from rclpy.serialization import serialize_message

    cdr = bytearray(serialize_message(message))
    start = end = 4

    def skip(size, count=1):
        nonlocal end
        padding = (start - end) % size if count else 0
        cdr[end:end + padding] = bytes(padding)
        end += padding + size * count

    def walk(kind, value):
        inner, count = elements(kind)
        if inner:
            if count is None:
                skip(4)
            if inner in TYPECODES:
                skip(size_of(inner), len(value))
            else:
                for each in value:
                    walk(inner, each)
        elif "/" in kind:
            for name, each in value.get_fields_and_field_types().items():
                walk(each, getattr(value, name))
        elif kind.startswith("string"):
            skip(4)
            skip(1, len(value.encode()) + 1)
        else:
            skip(size_of(kind))

    walk("/", message)
    if end != len(cdr):
        sys.exit(f"{type(message).__name__} has {len(cdr)} bytes of CDR, not {end}")
    return bytes(cdr)


def told(message):
    cdr = serialised(message)
    fields = {"time_ns": time.time_ns(), "bytes": len(cdr), "cdr_sha256": hashlib.sha256(cdr).hexdigest()}
    if hasattr(message, "seq"):
        fields["seq"] = message.seq
    return fields | {"message": plain(message, False)}


# Subcommands.


def quality(options):
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE if options.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if options.transient_local else DurabilityPolicy.VOLATILE,
        history=HistoryPolicy.KEEP_LAST,
        depth=options.depth,
    )


def listen(options, node, spin):
    received, seqs = 0, []

    def take(message):
        nonlocal received
        if received < options.count:
            say(received=received, **told(message))
            seqs.append(getattr(message, "seq", received))
            received += 1

    # Kept, or it would be collected.
    subscription = node.create_subscription(load(options.type), options.topic, take, quality(options))
    say(ready=True, type=options.type, topic=subscription.topic_name)
    spin(options.seconds, lambda: received >= options.count)
    say(summary={
        "received": received,
        "first": seqs[0] if seqs else None,
        "last": seqs[-1] if seqs else None,
        "lost": sorted(set(range(min(seqs), max(seqs))) - set(seqs)) if seqs else [],
        "disordered": sum(b <= a for a, b in zip(seqs, seqs[1:])),
    })


def talk(options, node, spin):
    publisher = node.create_publisher(load(options.type), options.topic, quality(options))
    say(ready=True, type=options.type, topic=publisher.topic_name)
    spin(options.seconds, lambda: publisher.get_subscription_count() > 0)
    if not publisher.get_subscription_count():
        sys.exit("no subscriber appeared")
    say(matched=publisher.get_subscription_count())
    # The subscriber may learn of this publisher a little later than this publisher of it.
    spin(options.settle, lambda: False)
    content = open(options.file, "rb").read() if options.file else None
    start = time.monotonic()
    sent = 0
    for index in range(options.count):
        if index % options.of + options.leave_out >= options.of:
            continue
        message = Filler(index, options.bytes, options.seed).message(load(options.type)())
        if content is not None:
            part = content[index * options.bytes:(index + 1) * options.bytes]
            if not part:
                break
            field = next(name for name, kind in message.get_fields_and_field_types().items() if kind == "sequence<uint8>")
            setattr(message, field, array.array("B", part))
        for each in options.set:
            name, value = each.split("=", 1)
            kind = type(getattr(message, name))
            setattr(message, name, value == "true" if kind is bool else kind(value))
        time.sleep(max(start + index / options.rate - time.monotonic(), 0))
        fields = told(message)
        publisher.publish(message)
        say(sent=index, **fields)
        sent += 1
    # What is on its way arrives.
    spin(1, lambda: False)
    say(summary={"sent": sent})


def graph(options, node, spin):
    def seen():
        return options.until and set(options.until) <= {name for name, _ in node.get_topic_names_and_types()}

    spin(options.seconds, seen)
    if options.until:
        # Nodes' names follow their topics.
        spin(1, lambda: False)

    def ends(infos):
        return [
            {
                "node": info.node_namespace.rstrip("/") + "/" + info.node_name,
                "type": info.topic_type,
                "hash": str(info.topic_type_hash),
                "reliability": info.qos_profile.reliability.name,
                "durability": info.qos_profile.durability.name,
                "history": info.qos_profile.history.name,
                "depth": info.qos_profile.depth,
            }
            for info in infos
            if info.node_name != node.get_name()
        ]

    topics = {}
    for name, types in node.get_topic_names_and_types():
        publishers = ends(node.get_publishers_info_by_topic(name))
        subscribers = ends(node.get_subscriptions_info_by_topic(name))
        if publishers or subscribers:
            topics[name] = {"types": types, "publishers": publishers, "subscribers": subscribers}
    nodes, services = [], {}
    for name, namespace in node.get_node_names_and_namespaces():
        if name != node.get_name():
            nodes.append(namespace.rstrip("/") + "/" + name)
            services |= dict(node.get_service_names_and_types_by_node(name, namespace))
    say(nodes=sorted(nodes), topics=topics, services=services)


def parameters(options, node, spin):
    from rclpy.parameter import Parameter, parameter_value_to_python
    from rclpy.parameter_client import AsyncParameterClient

    client = AsyncParameterClient(node, options.node)
    spin(options.seconds, client.services_are_ready)
    if not client.services_are_ready():
        sys.exit(f"the parameters of {options.node} did not appear")

    def result(future):
        spin(options.seconds, future.done)
        if not future.done():
            sys.exit("no answer arrived")
        return future.result()

    def parsed(text):
        name, value = text.split("=", 1)
        for kind in (int, float):
            try:
                return Parameter(name, value=kind(value))
            except ValueError:
                pass
        return Parameter(name, value={"true": True, "false": False}.get(value, value.strip("'")))

    def outcome(each):
        return {"successful": each.successful, "reason": each.reason}

    def described(each):
        return {
            "name": each.name,
            "type": each.type,
            "description": each.description,
            "additional_constraints": each.additional_constraints,
            "read_only": each.read_only,
            "dynamic_typing": each.dynamic_typing,
            "integer_range": [[one.from_value, one.to_value, one.step] for one in each.integer_range],
            "floating_point_range": [[one.from_value, one.to_value, one.step] for one in each.floating_point_range],
        }

    values = [parsed(each) for each in options.set]
    say(
        listed=sorted(result(client.list_parameters()).result.names),
        values=[parameter_value_to_python(each) for each in result(client.get_parameters(options.names)).values],
        types=list(result(client.get_parameter_types(options.names)).types),
        described=[described(each) for each in result(client.describe_parameters(options.names)).descriptors],
        undeclared=len(result(client.get_parameters(["no_such_name"])).values),
        set=[outcome(each) for each in result(client.set_parameters(values)).results] if values else [],
        atomically=outcome(result(client.set_parameters_atomically(values)).result) if values else None,
    )


def cdr(options):
    from rclpy.serialization import deserialize_message

    messages = []
    kind = load(options.type)
    for message in [kind()] + [Filler(index, options.bytes, options.seed).message(kind()) for index in range(4, 8)]:
        data = serialised(message)
        if deserialize_message(data, type(message)) != message:
            sys.exit(f"{options.type} does not read back as it was written")
        messages.append({"cdr": data.hex(), "values": plain(message, True)})
    say(type=options.type, hash=type_hash(options.type), messages=messages)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("listen", "talk"):
        command = commands.add_parser(name)
        command.add_argument("type")
        command.add_argument("topic")
        command.add_argument("--count", type=int, default=100)
        command.add_argument("--seconds", type=float, default=20, help="how long to listen or wait for a subscriber")
        command.add_argument("--reliable", action="store_true")
        command.add_argument("--best-effort", dest="reliable", action="store_false", help="the default")
        command.add_argument("--transient-local", action="store_true")
        command.add_argument("--depth", type=int, default=1000)
        if name == "talk":
            command.add_argument("--rate", type=float, default=100, help="Hz")
            command.add_argument("--settle", type=float, default=1, help="seconds from the match to the first message")
            command.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
            command.add_argument("--file")
            command.add_argument("--leave-out", type=int, default=0, metavar="R")
            command.add_argument("--of", type=int, default=1, metavar="N")
    command = commands.add_parser("graph")
    command.add_argument("--seconds", type=float, default=5)
    command.add_argument("--until", nargs="*", metavar="TOPIC", help="end one second after these are seen")
    command = commands.add_parser("parameters")
    command.add_argument("node")
    command.add_argument("--seconds", type=float, default=20)
    command.add_argument("--names", nargs="*", default=[])
    command.add_argument("--set", action="append", default=[], metavar="NAME=VALUE")
    command = commands.add_parser("cdr")
    command.add_argument("type")
    for command, size in ((commands.choices["talk"], 50_000), (command, 13)):
        command.add_argument("--bytes", type=int, default=size, help="size of each array of numbers")
        command.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()

    if options.command == "cdr":
        return cdr(options)

    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    rclpy.init()
    node = rclpy.create_node(f"rclpy_{options.command}")
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin(seconds, done):
        end = time.monotonic() + seconds
        while not done() and (left := end - time.monotonic()) > 0:
            executor.spin_once(timeout_sec=min(left, 0.05))

    try:
        {"listen": listen, "talk": talk, "graph": graph, "parameters": parameters}[options.command](options, node, spin)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()


if __name__ == "__main__":
    main()

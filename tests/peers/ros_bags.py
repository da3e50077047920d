"""Bags of ROS: those of rosbags and mcap, read by the command, and the other way round.

    python tests/peers/ros_bags.py EECVS [RECORDING ...]

Random events and each of the recordings are written as bags by the command. The encodings' words are packed and
unpacked here, by their definition alone. SQLite is left out where the command is built without it. comparison.py
says what is printed.
"""

import csv
import json
import pathlib
import sqlite3
import subprocess
import sys
import tempfile

import comparison
from comparison import np, package

if not (package("rosbags") and package("mcap") and package("mcap_ros2")):
    sys.exit(77)

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
# What rosbags reads metadata by.
from ruamel.yaml import YAML

PACKET = """std_msgs/Header header
uint32 height
uint32 width
uint64 seq
uint64 time_base
string encoding
bool is_bigendian
uint8[] events
"""
EVENT = "uint16 x\nuint16 y\ntime ts\nbool polarity\n"
EVENT_2 = EVENT.replace("time ts", "builtin_interfaces/Time ts")
ARRAY = "std_msgs/Header header\nuint32 height\nuint32 width\nEvent[] events\n"
WIDTH, HEIGHT = 640, 480
BASE_US = 1_675_956_550_000_000


def check(name, same):
    comparison.failures += not same
    print(f"{'ok      ' if same else 'differs '} {name}")


def store(version):
    types = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    kinds = get_types_from_msg(PACKET, "event_camera_msgs/msg/EventPacket")
    for package in ("dvs_msgs", "prophesee_event_msgs"):
        kinds |= get_types_from_msg(EVENT if version == 1 else EVENT_2, f"{package}/msg/Event")
        kinds |= get_types_from_msg(ARRAY, f"{package}/msg/EventArray")
    types.register(kinds)
    return types


def random_events(n):
    """Sorted times of which many are equal, and every corner of the sensor."""
    random = np.random.default_rng(7)
    t = BASE_US + np.sort(random.integers(0, 3_000_000, n))
    x, y = random.integers(0, WIDTH, n), random.integers(0, HEIGHT, n)
    return np.stack([t, x, y, random.integers(0, 2, n)], axis=1)


def libcaer(events, base_us):
    words = np.zeros((len(events), 2), "<u4")
    t, x, y, p = events.T
    words[:, 0] = x << 17 | y << 2 | p << 1 | 1
    words[:, 1] = (t - base_us) & 0x7FFF_FFFF
    return words.tobytes()


def libcaer_cmp(events, base_us):
    words, at = [], 0
    while at < len(events):
        t, x, y, p = (int(value) for value in events[at])
        since = t - base_us
        words += [since >> 12, 0x1000 | since & 0xFFF, 0x2000 | x]
        words += [0x3000 | p << 11 | y] if at % 3 else [0x4000 | p << 11 | y, 0x5001]
        at += 1
    return np.array(words, "<u2").tobytes()


def mono(events, base_us):
    t, x, y, p = (column.astype("<u8") for column in events.T)
    since = (t - np.uint64(base_us)) * np.uint64(1000)
    shifts = (np.uint64(shift) for shift in (32, 48, 63))
    words = since
    for value, shift in zip((x, y, p), shifts):
        words = words | value << shift
    return words.tobytes()


def evt3(events, _):
    words = []
    for t, x, y, p in events.tolist():
        since = t - BASE_US
        words += [0x8000 | since >> 12, 0x6000 | since & 0xFFF, y, 0x2000 | p << 11 | x]
    return np.array(words, "<u2").tobytes()


PACKERS = {"evt3": evt3, "libcaer": libcaer, "libcaer_cmp": libcaer_cmp, "mono": mono}


def header(types, version, t):
    time = types.types["builtin_interfaces/msg/Time"](t // 1_000_000, t % 1_000_000 * 1000)
    fields = {"stamp": time, "frame_id": "camera"}
    if version == 1:
        fields["seq"] = 0
    return types.types["std_msgs/msg/Header"](**fields)


def packets(types, version, events, encoding):
    """Messages of 1,000 events each, with their times."""
    for seq, first in enumerate(range(0, len(events), 1000)):
        part = events[first : first + 1000]
        base_us = int(part[0, 0]) - 5
        data = np.frombuffer(PACKERS[encoding](part, base_us), np.uint8)
        yield (
            base_us * 1000,
            types.types["event_camera_msgs/msg/EventPacket"](
                header=header(types, version, base_us),
                height=HEIGHT,
                width=WIDTH,
                seq=seq,
                time_base=0 if encoding == "evt3" else base_us * 1000,
                encoding=encoding,
                is_bigendian=False,
                events=data,
            ),
        )


def arrays(types, version, events, package):
    event = types.types[f"{package}/msg/Event"]
    time = types.types["builtin_interfaces/msg/Time"]
    for first in range(0, len(events), 1000):
        part = events[first : first + 1000].tolist()
        list_of = [
            event(x=x, y=y, ts=time(t // 1_000_000, t % 1_000_000 * 1000), polarity=bool(p))
            for t, x, y, p in part
        ]
        t = part[0][0]
        yield (
            t * 1000,
            types.types[f"{package}/msg/EventArray"](
                header=header(types, version, t), height=HEIGHT, width=WIDTH, events=list_of
            ),
        )


def read_csv(path):
    with open(path, newline="") as file:
        rows = [row for row in csv.reader(file) if row and row[0].lstrip("-").isdigit()]
    return np.array(rows, np.int64).reshape(-1, 4)


def ours(bag, folder):
    """What eecvs reads."""
    out = folder / "out.csv"
    result = subprocess.run([comparison.eecvs, "convert", "--overwrite", bag, out], capture_output=True, text=True)
    if result.returncode:
        print(result.stderr.strip())
        return None
    return read_csv(out)


def same(got, want):
    return got is not None and got.shape == want.shape and bool((got == want).all())


def write(version, path, topics, types, **how):
    """Writes messages of topics by turns."""
    if version == 1:
        writer = Writer1(path)
        if how.get("compression"):
            writer.set_compression(how["compression"])
    else:
        writer = Writer2(path, version=9, storage_plugin=how["plugin"])
        if how.get("compression"):
            writer.set_compression(how["compression"], how["format"])
    with writer:
        for topic, messages in topics.items():
            messages = list(messages)
            kind = messages[0][1].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=types)
            for t, message in messages:
                if version == 1:
                    data = types.serialize_ros1(message, kind)
                else:
                    data = types.serialize_cdr(message, kind, little_endian=how.get("little", True))
                writer.write(connection, t, data)


def has_db3(folder):
    """Whether the command is built with SQLite: it says so of a file that is none."""
    path = folder / "none.db3"
    path.write_bytes(b"SQLite format 3\0" + bytes(84))
    said = subprocess.run([comparison.eecvs, "info", path], capture_output=True, text=True).stderr
    if "--features" in said:
        print("absent: the feature db3")
    return "--features" not in said


def reading(folder):
    events = random_events(100_000)
    since = events - np.array([BASE_US, 0, 0, 0])
    types = {version: store(version) for version in (1, 2)}
    compressions = [None, Writer1.CompressionFormat.LZ4, Writer1.CompressionFormat.BZ2]
    for compression in compressions:
        name = f"{compression.name.lower() if compression else 'none'}"
        for encoding in PACKERS:
            path = folder / f"{encoding}_{name}.bag"
            messages = packets(types[1], 1, events, encoding)
            write(1, path, {"/events": messages}, types[1], compression=compression)
            want = since if encoding == "evt3" else events
            check(f"ROS 1 bag, {name}, {encoding}", same(ours(path, folder), want))
    for package in ("dvs_msgs", "prophesee_event_msgs"):
        few = events[:20_000]
        path = folder / f"{package}.bag"
        left, right = (
            arrays(types[1], 1, part, package) for part in (few, few[::2])
        )
        write(1, path, {"/left/events": left, "/right/events": right}, types[1])
        check(f"ROS 1 bag, {package}", same(ours(path, folder), few))
        other = ours(path / "right" / "events", folder)
        check(f"ROS 1 bag, {package}, another topic", same(other, few[::2]))
        path = folder / f"{package}_mcap"
        messages = {"/events": arrays(types[2], 2, few, package)}
        write(2, path, messages, types[2], plugin=StoragePlugin.MCAP)
        check(f"MCAP, {package}", same(ours(path, folder), few))
    plugins = [StoragePlugin.MCAP] + [StoragePlugin.SQLITE3] * has_db3(folder)
    for plugin in plugins:
        for encoding in PACKERS:
            for little in (True, False):
                path = folder / f"{plugin.name.lower()}_{encoding}_{little}"
                messages = {"/events": packets(types[2], 2, events, encoding)}
                write(2, path, messages, types[2], plugin=plugin, little=little)
                want = since if encoding == "evt3" else events
                name = f"{plugin.name}, {encoding}, {'little' if little else 'big'} endian"
                check(name, same(ours(path, folder), want))
                if little:
                    file = next(file for file in path.iterdir() if file.suffix != ".yaml")
                    check(f"{name}, the file alone", same(ours(file, folder), want))


def chunked(folder):
    """MCAP files with chunks of each compression, with and without a summary."""
    from mcap.writer import CompressionType
    from mcap.writer import Writer as McapWriter

    events = random_events(100_000)
    types = store(2)
    for compression in CompressionType:
        for whole in (True, False):
            path = folder / f"{compression.name}_{whole}.mcap"
            with open(path, "wb") as file:
                writer = McapWriter(file, compression=compression)
                writer.start("ros2", "peer")
                name = "event_camera_msgs/msg/EventPacket"
                schema = writer.register_schema(name, "ros2msg", PACKET.encode())
                channel = writer.register_channel("/events", "cdr", schema)
                for t, message in packets(types, 2, events, "libcaer"):
                    data = bytes(types.serialize_cdr(message, message.__msgtype__))
                    writer.add_message(channel, t, data, t)
                writer.finish()
            if not whole:
                path.write_bytes(path.read_bytes()[:-400])
            got = ours(path, folder)
            check(f"MCAP chunks {compression.name}, summary whole: {whole}", same(got, events))


def unpack(message):
    """The events of a message in `libcaer`."""
    if message.encoding != "libcaer" or message.is_bigendian:
        raise ValueError(f"encoding {message.encoding}")
    words = np.frombuffer(bytes(message.events), "<u4").reshape(-1, 2).astype(np.int64)
    data, since = words[:, 0], words[:, 1]
    if (np.diff(since) < 0).any():
        raise ValueError("a reader takes a step back within a message for a roll-over")
    t = message.time_base // 1000 + since
    return np.stack([t, data >> 17, data >> 2 & 0x7FFF, data >> 1 & 1], axis=1)


def stamp_ns(stamp):
    nanos = stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsecs
    return stamp.sec * 1_000_000_000 + nanos


def collect(messages, size):
    """The events of messages with the times that they are stored under."""
    parts, last = [np.zeros((0, 4), np.int64)], 0
    for seq, (time_ns, message) in enumerate(messages):
        stamp = stamp_ns(message.header.stamp)
        right = message.seq == seq and (message.width, message.height) == size
        last = max(last, stamp)
        if not right or stamp != message.time_base or time_ns != last:
            print(f"message {seq}: {message.seq}, {message.width}x{message.height}, {time_ns}, {stamp}")
            return None
        parts.append(unpack(message))
    return np.concatenate(parts)


def by_rosbags(path, kind):
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    with Reader1(path) if kind == "bag" else Reader2(path) as reader:
        types = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_HUMBLE)
        # The definitions in the file.
        for connection in reader.connections:
            definition = connection.msgdef.data
            types.register(get_types_from_msg(definition, connection.msgtype))
            if kind == "bag":
                expected = types.generate_msgdef(connection.msgtype)[1]
                check(f"{path.name}: MD5 of the definition", connection.digest == expected)
        read = types.deserialize_ros1 if kind == "bag" else types.deserialize_cdr
        for connection, time_ns, data in reader.messages():
            yield time_ns, read(data, connection.msgtype)


def by_mcap(path):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, _, message, decoded in reader.iter_decoded_messages():
            yield message.log_time, decoded


METADATA = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  duration: {{nanoseconds: 1}}
  starting_time: {{nanoseconds_since_epoch: 0}}
  message_count: {count}
  topics_with_message_count:
    - topic_metadata:
        name: /event_camera/events
        type: event_camera_msgs/msg/EventPacket
        serialization_format: cdr
        offered_qos_profiles: ""
      message_count: {count}
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - {file}
"""


def describe(bag, text):
    """What makes a bag of ROS 2 of a file and its folder."""
    (bag.parent / "metadata.yaml").write_text(text)


def tables(path):
    with sqlite3.connect(path) as database:
        rows = database.execute("SELECT name, sql FROM sqlite_master ORDER BY name").fetchall()
    return [(name, "".join(sql.split())) for name, sql in rows]


def check_database(bag, name):
    """Compares what rosbags does not ask a database for; gives a `metadata.yaml` of what is told in it."""
    kind_hash = store(2).hash_rihs01("event_camera_msgs/msg/EventPacket")
    with sqlite3.connect(bag) as database:
        times = "SELECT count(*), min(timestamp), max(timestamp) FROM messages"
        count, first, last = database.execute(times).fetchone()
        version, text = database.execute("SELECT metadata_version, metadata FROM metadata").fetchone()
        hashes = database.execute("SELECT type_description_hash FROM topics").fetchall()
    check(f"{name}, db3: hash of the definition", hashes == [(kind_hash,)])
    # rosbags makes rosbag2's.
    path = bag.parent / "empty"
    with Writer2(path, version=9, storage_plugin=StoragePlugin.SQLITE3):
        pass
    check(f"{name}, db3: tables", tables(bag) == tables(path / "empty.db3"))
    told = YAML(typ="safe").load(text)
    spans = {
        "starting_time": {"nanoseconds_since_epoch": first},
        "duration": {"nanoseconds": last - first},
        "message_count": count,
    }
    topic = told["topics_with_message_count"][0]
    right = [
        told["version"] == version,
        told["relative_file_paths"] == [bag.name],
        told["files"] == [spans | {"path": bag.name}],
        spans.items() <= told.items(),
        topic["message_count"] == count,
        topic["topic_metadata"]["type_description_hash"] == kind_hash,
    ]
    check(f"{name}, db3: metadata", all(right))
    return "rosbag2_bagfile_information:\n" + "".join(f"  {line}\n" for line in text.splitlines())


def writing(folder, source, name, size=None):
    """Bags that eecvs writes of `source`."""
    sides = ["--width", str(size[0]), "--height", str(size[1])] if size else []
    if size:
        want = read_csv(source)
    else:
        told = json.loads(subprocess.check_output([comparison.eecvs, "info", "--json", source]))
        size = (told["width"], told["height"])
        text = folder / f"{name}.csv"
        subprocess.run([comparison.eecvs, "convert", "--overwrite", source, text], check=True, capture_output=True)
        want = read_csv(text)
    for kind in ("bag", "mcap") + ("db3",) * has_db3(folder):
        bag = folder / f"{name}_{kind}" / f"{name}.{kind}"
        bag.parent.mkdir(exist_ok=True)
        result = subprocess.run([comparison.eecvs, "convert", "--overwrite", source, bag, *sides], capture_output=True, text=True)
        if result.returncode:
            print(result.stderr.strip())
            check(f"{name}, {kind}", False)
            continue
        if kind == "mcap":
            got = collect(by_mcap(bag), size)
            check(f"{name}, {kind}, {len(want)} events, by mcap and mcap-ros2-support", same(got, want))
            count = sum(1 for _ in by_mcap(bag))
            describe(bag, METADATA.format(file=bag.name, count=count))
        if kind == "db3":
            describe(bag, check_database(bag, name))
        path = bag if kind == "bag" else bag.parent
        got = collect(by_rosbags(path, kind), size)
        check(f"{name}, {kind}, {len(want)} events, by rosbags", same(got, want))
        if kind == "db3":
            check(f"{name}, {kind}, the file alone, by rosbags", same(collect(by_rosbags(bag, kind), size), want))


def written(folder):
    events = random_events(100_000)
    # Steps back too.
    events[::50, 0] -= 40
    source = folder / "random.csv"
    with open(source, "w") as file:
        file.write("t,x,y,p\n")
        np.savetxt(file, events, "%d", ",")
    writing(folder, source, "random_events", (WIDTH, HEIGHT))


def recording(path):
    with tempfile.TemporaryDirectory() as folder:
        writing(pathlib.Path(folder), path, path.stem.replace(".", "_"))


def made(folder):
    written(folder)
    reading(folder)
    chunked(folder)


if __name__ == "__main__":
    comparison.run(__doc__, recording, made)

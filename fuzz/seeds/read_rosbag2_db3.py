"""Makes the seeds of bags in SQLite: python3 fuzz/seeds/read_rosbag2_db3.py

Pages of 512 bytes, so that a whole database is below the inputs' 8,192 bytes. The events are those of the other
formats' seeds.
"""

import pathlib
import sqlite3
import struct

FOLDER = pathlib.Path(__file__).parent / "read_rosbag2_db3"


def packet(sequence, first, count):
    """An EventPacket in CDR, its events as libcaer packs them."""
    base_us = 1000 + first * 17
    words = b"".join(
        struct.pack("<II", (i * 7 % 64) << 17 | (i * 3 % 48) << 2 | (i % 3 == 0) << 1 | 1, i * 17 - first * 17)
        for i in range(first, first + count)
    )
    head = struct.pack("<III", 0, base_us * 1000, 2) + b"c\0\0\0"
    head += struct.pack("<II", 48, 64)
    head += struct.pack("<QQ", sequence, base_us * 1000)
    head += struct.pack("<I", 8) + b"libcaer\0\0\0\0\0"
    return b"\0\1\0\0" + head + struct.pack("<I", len(words)) + words


def write(name, messages):
    path = FOLDER / name
    path.unlink(missing_ok=True)
    database = sqlite3.connect(path)
    database.executescript("""
        PRAGMA page_size = 512;
        CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
    """)
    kind = "event_camera_msgs/msg/EventPacket"
    database.execute("INSERT INTO topics VALUES (1, '/events', ?, 'cdr'), (2, '/imu', 'sensor_msgs/msg/Imu', 'cdr')", [kind])
    for number, (topic, data) in enumerate(messages):
        database.execute("INSERT INTO messages VALUES (?, ?, ?, ?)", [number + 1, topic, number, data])
    database.commit()
    database.close()


FOLDER.mkdir(exist_ok=True)
write("short.db3", [(1, packet(i, 5 * i, 5)) for i in range(4)])
# Longer than a page; other messages between.
write("long.db3", [(1, packet(0, 0, 150)), (2, b"\0" * 30), (1, packet(1, 150, 90))])

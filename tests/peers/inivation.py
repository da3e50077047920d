"""AEDAT 4 against independent decoders: aedat and faery.

    python tests/peers/inivation.py EECVS [RECORDING.aedat4 ...]

Each of the recordings is read by both; so are random events that the command writes, and the command reads
those that faery writes. comparison.py says what is printed.
"""

import sys

import comparison
from comparison import check, events, faery, faery_stream, faerys, np, ours, package, random_events, write_ours

aedat = package("aedat")
if not (faery or aedat):
    sys.exit(77)


def aedats(path):
    packets = [packet["events"] for packet in aedat.Decoder(str(path)) if "events" in packet]
    return events(*(np.concatenate([packet[name] for packet in packets]) for name in ("t", "x", "y", "on")))


def by_both(name, path, want):
    if aedat:
        check(f"{name} by aedat", aedats(path), want)
    if faery:
        check(f"{name} by faery", faerys(path, None), want)


def recording(path):
    by_both(path.name, path, ours(path))


def made(folder):
    size = (346, 260)
    for name, start in [("plain", 1_000), ("absolute", 1_700_000_000_000_000)]:
        array = random_events(size, start, 50)
        path = folder / f"{name}.aedat4"
        write_ours(path, array, size)
        check(f"our {name} AEDAT 4", ours(path), array)
        by_both(f"our {name} AEDAT 4", path, array)
        if faery:
            path = folder / f"faery_{name}.aedat4"
            faery_stream(array, size).to_file(path)
            check(f"faery's {name} AEDAT 4", ours(path), array)


if __name__ == "__main__":
    comparison.run(__doc__, recording, made)

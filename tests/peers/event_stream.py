"""Event Stream against an independent decoder: faery.

    python tests/peers/event_stream.py EECVS [RECORDING.es ...]

Each of the recordings is read by both; then random events go from each writer to each reader. comparison.py
says what is printed.
"""

import sys

import comparison
from comparison import check, faery, faery_stream, faerys, ours, random_events, write_ours

if not faery:
    sys.exit(77)


def recording(path):
    check(f"{path.name} by faery", ours(path), faerys(path, None))


def made(folder):
    size = (346, 260)
    for name, start, step_max in [("plain", 1_000, 50), ("silences", 0, 10_000), ("late", 1 << 33, 50)]:
        array = random_events(size, start, step_max)
        path = folder / f"{name}.es"
        write_ours(path, array, size)
        check(f"our {name} es", ours(path), array)
        check(f"our {name} es by faery", faerys(path, None), array)
        for zero in (True, False):
            path = folder / f"faery_{name}_{zero}.es"
            faery_stream(array, size).to_file(path, zero_t0=zero)
            want = array.copy()
            # The format has no field for it.
            want["t"] -= array["t"][0] if zero else 0
            check(f"faery's {name} es, from 0: {zero}", ours(path), want)


if __name__ == "__main__":
    comparison.run(__doc__, recording, made)

"""N-MNIST's files against tonic.

    python tests/peers/nmnist.py EECVS [RECORDING ...]

Random events are written by the command and read by tonic, and the other way round, as are the recordings.
comparison.py says what is printed. Of tonic its module of readers is enough (`pip install --no-deps tonic`).
"""

import importlib.util
import pathlib
import sys

import comparison
from comparison import EVENTS, check, eecvs_run, events, np, ours

SIZE = (256, 240)


def tonic_io():
    """tonic.io without what else tonic imports."""
    found = importlib.util.find_spec("tonic")
    if not found:
        print("absent: tonic")
        sys.exit(77)
    path = pathlib.Path(found.origin).with_name("io.py")
    spec = importlib.util.spec_from_file_location("tonic_io", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


io = tonic_io()


def theirs(path):
    read = io.read_mnist_file(path, dtype=io.events_struct)
    return events(read["t"], read["x"], read["y"], read["p"])


def recording(path):
    check(path.name, ours(path), theirs(path))


def made(empty):
    random = np.random.default_rng(11)
    t = np.sort(random.integers(0, 1 << 23, EVENTS))
    # Steps back too.
    t[::50] = np.maximum(t[::50] - 40, 0)
    x, y = random.integers(0, SIZE[0], EVENTS), random.integers(0, SIZE[1], EVENTS)
    p = random.integers(0, 2, EVENTS)
    source = empty / "random.npz"
    np.savez(source, t=t, x=x, y=y, p=p, width=SIZE[0], height=SIZE[1])
    path = empty / "ours.bin"
    eecvs_run("convert", source, path)
    check("random events: our .bin", theirs(path), events(t, x, y, p))
    # Records that let time pass, which the command does not write.
    records = bytearray(path.read_bytes())
    records[5 * 1000 + 1 : 5 * EVENTS : 5 * 1000] = bytes([240]) * (EVENTS // 1000 - 1)
    path.write_bytes(records)
    check("random records: .bin", ours(path, SIZE), theirs(path))


if __name__ == "__main__":
    comparison.run(__doc__, recording, made)

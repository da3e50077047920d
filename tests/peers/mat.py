"""MATLAB's files against scipy.

    python tests/peers/mat.py EECVS [RECORDING ...]

The events of each of the recordings, and random ones, are written by the command and read by scipy; random ones
are written by scipy, in every layout and class that is read, and read by the command. comparison.py says what is
printed.
"""

import pathlib
import sys
import tempfile

import comparison
from comparison import EVENTS, check, eecvs_run, events, np, ours, package

SIZE = (1280, 720)

io = package("scipy.io")
if not io:
    sys.exit(77)


def theirs(path):
    """The events of a file of the command as scipy reads them."""
    td = io.loadmat(path)["TD"][0, 0]
    return events(*(td[name].ravel() for name in ("ts", "x", "y", "p")))


def recording(path):
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "ours.mat"
        eecvs_run("convert", path, out)
        check(f"{path.name}: our .mat", theirs(out), ours(path))


def made(empty):
    random = np.random.default_rng(9)
    t = np.cumsum(random.integers(-3, 25, EVENTS)) + 1_600_000_000_000_000
    x, y = random.integers(0, SIZE[0], EVENTS), random.integers(0, SIZE[1], EVENTS)
    p = random.integers(0, 2, EVENTS)
    want = events(t, x, y, p)
    source = empty / "random.npz"
    np.savez(source, t=t, x=x, y=y, p=p, width=SIZE[0], height=SIZE[1])
    path = empty / "ours.mat"
    eecvs_run("convert", source, path)
    check("random events: our .mat", theirs(path), want)
    scalars = {"width": SIZE[0], "height": SIZE[1]}
    from_one = {"x": x + 1, "y": y + 1, "p": p + 1, "ts": t}
    layouts = {
        "structure of doubles": {"td": {"x": x * 1.0, "y": y * 1.0, "p": p * 2.0 - 1, "ts": t * 1.0}},
        "structure of integers": {"TD": {"x": x.astype("u2"), "y": y.astype("i2"), "p": p.astype("i1"), "t": t}},
        "structure that counts from 1": {"TD": {name: column * 1.0 for name, column in from_one.items()}},
        "variables": {"t": t, "x": x.astype("u4"), "y": y.astype("f4"), "p": p.astype(bool)},
        "variables, times in seconds": {"t": (t - t.min()) / 1e6, "x": x, "y": y, "pol": p},
        "matrix of doubles": {"events": np.stack([t, x, y, p], axis=1) * 1.0},
        "matrix of integers": {"a": np.stack([x, y, t, p], axis=1)},
    }
    for (name, variables), packed, shape in (
        (layout, packed, shape) for layout in layouts.items() for packed in (False, True) for shape in ("row", "column")
    ):
        path = empty / "theirs.mat"
        io.savemat(path, {**variables, **scalars}, do_compression=packed, oned_as=shape)
        expected = events(t - t.min(), x, y, p) if "seconds" in name else want
        check(f"scipy: {name}, {shape}, {'compressed' if packed else 'plain'}", ours(path, SIZE), expected)


if __name__ == "__main__":
    comparison.run(__doc__, recording, made)

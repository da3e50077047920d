"""What the comparisons with independent decoders have in common. They are run as

    python tests/peers/NAME.py EECVS [RECORDING ...]

where EECVS is the command. They print for each check `ok` or `differs`, and exit with 1 on a difference; they
print which decoders are absent, and exit with 77 where all are, or numpy.
"""

import pathlib
import subprocess
import sys
import tempfile

try:
    import numpy as np
except ImportError:
    print("absent: numpy")
    sys.exit(77)

EVENTS = 100_000
DTYPE = [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("p", "<u1")]
failures = 0


def package(name):
    try:
        return __import__(name, fromlist=["_"])
    except ImportError:
        print(f"absent: {name}")
        return None


def run(script, recording, made):
    """Calls `recording` with every recording of the command line, and `made` with an empty folder."""
    global eecvs
    if len(sys.argv) < 2:
        sys.exit(script)
    eecvs = sys.argv[1]
    for name in sys.argv[2:]:
        recording(pathlib.Path(name))
    with tempfile.TemporaryDirectory() as name:
        made(pathlib.Path(name))
    sys.exit(failures > 0)


def events(t, x, y, p):
    """The columns as one array; whatever a decoder calls a rise in brightness is 1."""
    array = np.empty(len(t), DTYPE)
    array["t"], array["x"], array["y"] = t, x, y
    array["p"] = np.asarray(p).astype(np.int64) > 0
    return array


def check(name, got, want):
    global failures
    if len(got) == len(want) and np.array_equal(got, want):
        print(f"ok       {name}: {len(want)} events")
        return
    failures += 1
    common = min(len(got), len(want))
    wrong = np.flatnonzero(got[:common] != want[:common])
    at = f", first at {wrong[0]}: {got[wrong[0]]} {want[wrong[0]]}" if len(wrong) else ""
    print(f"differs  {name}: {len(got)} and {len(want)} events, {len(wrong)} differ{at}")


def verdict(name, is_right):
    global failures
    print(f"{'ok      ' if is_right else 'differs '} {name}")
    failures += not is_right


def eecvs_run(*arguments):
    run = subprocess.run([eecvs, *map(str, arguments)], capture_output=True, text=True)
    if run.returncode != 0:
        sys.exit(f"{arguments}: {run.stderr}")
    return run.stdout


def ours(path, size=None):
    """The events of a recording as the command reads them."""
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "events.npz"
        options = ["--width", size[0], "--height", size[1]] if size else []
        eecvs_run("convert", path, out, *options)
        with np.load(out) as arrays:
            return events(*(arrays[name] for name in "txyp"))


def write_ours(path, array, size):
    """Writes events by the command, out of an .npz."""
    source = path.with_suffix(path.suffix + ".npz")
    p = array["p"].astype(np.uint8)
    np.savez(source, x=array["x"], y=array["y"], t=array["t"].astype(np.int64), p=p)
    eecvs_run("convert", source, path, "--width", size[0], "--height", size[1])


def random_events(size, start, step_max):
    """Events whose times ascend, in part neighbours in a row."""
    random = np.random.default_rng(1)
    t = start + np.cumsum(random.integers(0, step_max, EVENTS) * (random.random(EVENTS) < 0.4))
    x, y = random.integers(0, size[0], EVENTS), random.integers(0, size[1], EVENTS)
    p = random.integers(0, 2, EVENTS)
    for i in np.flatnonzero(random.random(EVENTS) < 0.6):
        if i and x[i - 1] + 1 < size[0]:
            t[i:] -= t[i] - t[i - 1]
            x[i], y[i], p[i] = x[i - 1] + 1, y[i - 1], p[i - 1]
    return events(t, x, y, p)


faery = package("faery")


def faerys(path, size):
    stream = faery.events_stream_from_file(path, dimensions_fallback=size)
    array = stream.to_array()
    return events(array["t"], array["x"], array["y"], array["on"])


def faery_stream(array, size):
    columns = np.empty(len(array), faery.EVENTS_DTYPE)
    for there, here in [("t", "t"), ("x", "x"), ("y", "y"), ("on", "p")]:
        columns[there] = array[here]
    return faery.events_stream_from_array(columns, dimensions=size)

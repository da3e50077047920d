"""Prophesee's formats against independent decoders: faery, expelliarmus, evt3, evlib.

    python tests/peers/prophesee.py EECVS [RECORDING.dat|RECORDING.raw ...]

EECVS is the command. Prints for each check `ok` or `differs`, and exits with 1 on a difference. Each of the
recordings is read by every decoder that knows its format; then random events go from each writer
to each reader. For EVT 4.0, which none of them knows, and for EVT 2.1, which faery only names, in both orders of bytes, a few lines here decode
the words as Prophesee defines them.
Needs numpy and those of the decoders that are to be compared with; prints which are absent.
"""

import json
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

EVENTS = 100_000
DTYPE = [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("p", "<u1")]
failures = 0


def package(name):
    try:
        return __import__(name)
    except ImportError:
        print(f"absent: {name}")
        return None


faery = package("faery")
expelliarmus = package("expelliarmus")
evt3 = package("evt3")
evlib = package("evlib")


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


def faerys(path, size):
    stream = faery.events_stream_from_file(path, dimensions_fallback=size)
    array = stream.to_array()
    return events(array["t"], array["x"], array["y"], array["on"])


def faery_stream(array, size):
    columns = np.empty(len(array), faery.EVENTS_DTYPE)
    for there, here in [("t", "t"), ("x", "x"), ("y", "y"), ("on", "p")]:
        columns[there] = array[here]
    return faery.events_stream_from_array(columns, dimensions=size)


def expelliarmuss(path, encoding):
    array = expelliarmus.Wizard(encoding=encoding).read(path)
    return events(array["t"], array["x"], array["y"], array["p"])


def evt3s(path):
    array = evt3.decode_file(str(path))
    columns = [np.asarray(getattr(array, name)) for name in ("timestamp", "x", "y", "polarity")]
    return events(*columns)


def evlibs(path):
    frame = evlib.load_events(str(path), sort=False).collect()
    t = frame["t"]
    t = t.dt.total_microseconds() if "Duration" in str(t.dtype) else t
    return events(t.to_numpy(), frame["x"].to_numpy(), frame["y"].to_numpy(), frame["polarity"].to_numpy())


def words_of(path, dtype):
    """The words behind a header that ends with `% end`."""
    data = path.read_bytes()
    start = data.index(b"% end\n") + 6
    return np.frombuffer(data[start:], dtype)


def vectors(heads, columns):
    """One event for each bit of each vector's columns, the lowest first."""
    bits = (columns[:, None] >> np.arange(32, dtype=np.uint64)) & 1
    vector, column = np.nonzero(bits)
    heads = heads[vector]
    low = heads >> 22 & 63
    return vector, low, (heads >> 11 & 0x7FF) + column.astype(np.uint64), heads & 0x7FF


def wrapped_highs(highs):
    """Upper bits of time with their wraps, for times that ascend."""
    wraps = np.concatenate([[0], np.cumsum(np.diff(highs.astype(np.int64)) < 0)])
    return highs + (wraps.astype(np.uint64) << np.uint64(28))


def decode_evt21(words):
    kind = words >> np.uint64(60)
    upper = words >> np.uint64(32)
    is_time = kind == 8
    highs = wrapped_highs(upper[is_time] & np.uint64(0xFFFFFFF))
    high = np.concatenate([[0], highs]).astype(np.uint64)[np.cumsum(is_time)]
    is_vector = kind < 2
    vector, low, x, y = vectors(upper[is_vector], words[is_vector] & np.uint64(0xFFFFFFFF))
    return events(high[is_vector][vector] << np.uint64(6) | low, x, y, kind[is_vector][vector])


def decode_evt4(words):
    rows, high, wraps, last, index = [], 0, 0, None, 0
    words = words.astype(np.uint64)
    while index < len(words):
        word = int(words[index])
        kind = word >> 28
        index += 1
        if kind == 14:
            high = word & 0xFFFFFFF
            wraps += last is not None and high < last
            last = high
        elif kind in (10, 11, 12, 13):
            columns = 1
            if kind > 11:
                columns = int(words[index])
                index += 1
            t = (wraps << 34) + (high << 6) + (word >> 22 & 63)
            for column in range(32):
                if columns >> column & 1:
                    rows.append((t, (word >> 11 & 0x7FF) + column, word & 0x7FF, kind & 1))
    return np.array(rows, DTYPE)


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


def recording(path):
    size = None
    info = subprocess.run([eecvs, "info", path, "--json"], capture_output=True, text=True)
    if info.returncode != 0:
        # N-CARS, whose header has no size.
        size = (304, 240)
        info = subprocess.run(
            [eecvs, "info", path, "--json", "--width", "304", "--height", "240"],
            capture_output=True, text=True, check=True,
        )
    kind = json.loads(info.stdout)["format"]
    read = ours(path, size)
    # faery's stream has no events of type 0, which N-CARS is of.
    if faery and kind in ("dat", "evt2", "evt3") and size is None:
        check(f"{path.name} by faery", read, faerys(path, (1280, 720)))
    # expelliarmus takes a TIME_LOW that steps back for a wrap, as evt3.rs says.
    if expelliarmus and kind in ("dat", "evt2"):
        check(f"{path.name} by expelliarmus", read, expelliarmuss(path, kind))
    if evt3 and kind == "evt3":
        check(f"{path.name} by evt3", read, evt3s(path))
    if evlib and kind in ("evt2", "evt21", "evt3"):
        check(f"{path.name} by evlib", read, evlibs(path))


def made(folder):
    size = (346, 260)
    plain = random_events(size, 1_000, 50)
    late = random_events(size, (1 << 32) - 1_000_000, 50)
    absolute = random_events(size, 1_700_000_000_000_000, 50)
    for name, array in [("plain", plain), ("wrap", late), ("absolute", absolute)]:
        path = folder / f"{name}.dat"
        write_ours(path, array, size)
        check(f"our {name} dat", ours(path), array)
        if faery:
            check(f"our {name} dat by faery", faerys(path, size), array)
        # It knows no T0.
        if expelliarmus and name != "absolute":
            check(f"our {name} dat by expelliarmus", expelliarmuss(path, "dat"), array)
        if faery:
            for version, zero in [("dat1", True), ("dat2", True), ("dat2", False)]:
                # Without a T0 it drops what exceeds 32 bits.
                if not zero and name == "absolute":
                    continue
                fits = (array["y"] < 256) | (version == "dat2")
                sizes = (346, 256) if version == "dat1" else size
                path = folder / f"faery_{name}_{version}_{zero}.dat"
                faery_stream(array[fits], sizes).to_file(path, version=version, zero_t0=zero)
                check(f"faery's {name} {version}, T0 {zero}", ours(path), array[fits])
    if expelliarmus:
        path = folder / "expelliarmus.dat"
        columns = np.empty(len(plain), expelliarmus.Wizard(encoding="dat").read(folder / "plain.dat").dtype)
        for name in "txyp":
            columns[name] = plain[name]
        expelliarmus.Wizard(encoding="dat").save(path, columns)
        check("expelliarmus's dat", ours(path, size), plain)

    for name, array in [
        ("plain", plain),
        ("wrap", random_events(size, (1 << 34) - 1_000_000, 50)),
        ("silences", random_events(size, 1_000, 1_000_000)),
    ]:
        path = folder / f"{name}.evt21.raw"
        write_ours(path, array, size)
        words = words_of(path, "<u8")
        check(f"our {name} evt21", ours(path), array)
        check(f"our {name} evt21 by the words", decode_evt21(words), array)
        if evlib:
            check(f"our {name} evt21 by evlib", evlibs(path), array)
        # The other order, told by the header and by the words.
        header = path.read_bytes().split(b"% end\n")[0]
        legacy = header.replace(b"little", b"legacy")
        silent = header.replace(b"% endianness little\n", b"").replace(b";endianness=little", b"")
        halves = words.view("<u4").reshape(-1, 2)[:, ::-1].tobytes()
        for title, text, data in [
            ("upper first", legacy, halves),
            ("upper first, untold", silent, halves),
            ("little, untold", silent, words.tobytes()),
        ]:
            other = folder / "other.raw"
            other.write_bytes(text + b"% end\n" + data)
            check(f"{name} evt21, {title}", ours(other), array)
        path = folder / f"{name}.evt4.raw"
        write_ours(path, array, size)
        check(f"our {name} evt4", ours(path), array)
        check(f"our {name} evt4 by the words", decode_evt4(words_of(path, "<u4")), array)
    for kind, extension in [("evt2", "evt2.raw"), ("evt3", "raw")]:
        path = folder / f"plain.{extension}"
        write_ours(path, plain, size)
        if faery:
            check(f"our {kind} by faery", faerys(path, size), plain)
            for zero in (True, False):
                path = folder / f"faery_{zero}.raw"
                faery_stream(plain, size).to_file(path, version=kind, zero_t0=zero)
                check(f"faery's {kind}, T0 {zero}", ours(path), plain)
        if expelliarmus and kind == "evt2":
            path = folder / f"plain.{extension}"
            check(f"our {kind} by expelliarmus", expelliarmuss(path, kind), plain)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    eecvs = sys.argv[1]
    for name in sys.argv[2:]:
        recording(pathlib.Path(name))
    with tempfile.TemporaryDirectory() as name:
        made(pathlib.Path(name))
    sys.exit(failures > 0)

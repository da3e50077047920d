"""Prophesee's formats against independent decoders: faery, expelliarmus, evt3, evlib.

    python tests/peers/prophesee.py EECVS [RECORDING.dat|RECORDING.raw ...]

Each of the recordings is read by every decoder that knows its format; then random events go from each writer
to each reader. For EVT 4.0, which none of them knows, and for EVT 2.1, which faery only names, in both orders of
bytes, a few lines here decode the words as Prophesee defines them. comparison.py says what is printed.
"""

import json
import subprocess
import sys

import comparison
from comparison import DTYPE, check, events, faery, faery_stream, faerys, np, ours, package, random_events, write_ours

expelliarmus = package("expelliarmus")
evt3 = package("evt3")
evlib = package("evlib")
if not (faery or expelliarmus or evt3 or evlib):
    sys.exit(77)


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


def recording(path):
    size = None
    info = subprocess.run([comparison.eecvs, "info", path, "--json"], capture_output=True, text=True)
    if info.returncode != 0:
        # N-CARS, whose header has no size.
        size = (304, 240)
        info = subprocess.run(
            [comparison.eecvs, "info", path, "--json", "--width", "304", "--height", "240"],
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
    comparison.run(__doc__, recording, made)

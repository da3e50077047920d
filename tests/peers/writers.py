"""Every writer against every package that reads its format, on five kinds of events.

    python tests/peers/writers.py EECVS [FILE.md]

The kinds are random events in every column and row; runs of neighbours in a row, which are vectors in some formats;
gaps longer than the format's counter of time; times on both sides of every roll-over of that counter; and a recording
without events. `KNOWN` has what packages get wrong by themselves, with what is still compared then. FILE.md gets the
table of crates/event-files/README.md. comparison.py says what is printed.
"""

import contextlib
import csv
import importlib.metadata
import importlib.util
import io
import pathlib
import subprocess
import sys
import warnings

import comparison
from comparison import DTYPE, events, np

KINDS = ["random", "vectors", "gaps", "roll-overs", "empty"]


# The five kinds.


def joined(parts):
    return np.concatenate([events(*part) for part in parts]) if parts else np.empty(0, DTYPE)


def random_kind(size, _):
    """Every column and row, in a random order, at times that ascend by 0 to 40 us."""
    random = np.random.default_rng(21)
    n = 20_000
    x, y = random.permutation(np.arange(n) % size[0]), random.permutation(np.arange(n) % size[1])
    return events(1_000 + np.cumsum(random.integers(0, 41, n)), x, y, random.integers(0, 2, n))


def vectors_kind(size, _):
    """In every row a part of the columns, in some rows all of them; each row at one time, by ascending columns."""
    random = np.random.default_rng(22)
    parts, t = [], 5_000
    for y in range(size[1]):
        for share in [0.4, 1.0] if y % 24 == 0 else [0.4]:
            # Neighbours rather than single columns.
            begins = np.repeat(random.random(size[0] // 3 + 1) < share, 3)[: size[0]]
            x = np.flatnonzero(begins & (random.random(size[0]) < max(share, 0.9)))
            t += int(random.integers(0, 30))
            parts.append((np.full(len(x), t), x, np.full(len(x), y), np.full(len(x), y // 2 % 2)))
    return joined(parts)


def gaps_kind(size, counter):
    """Silences around half a period of the counter, one and several periods, with a few events after each."""
    period = counter.period_us
    gaps = [1, 63, 64, 4_095, 4_096, 100_000, period // 2 - 1, period // 2 - 1, period // 2, period // 2 + 1]
    gaps += [period - 1, period, period + 1, 2 * period + 12_345, 5 * period // 2, 7]
    gaps = [gap for gap in [*gaps, 20_000_000] if gap <= counter.gap_max_us]
    starts = 1_000 + np.cumsum(np.array(gaps) + 297)
    t = (starts[:, None] + np.arange(0, 300, 3)[None, :]).ravel()
    t = t[t <= counter.t_max_us]
    random = np.random.default_rng(23)
    return events(t, random.integers(0, size[0], len(t)), random.integers(0, size[1], len(t)),
                  random.integers(0, 2, len(t)))


def roll_overs_kind(size, counter):
    """Times around three roll-overs of the counter, one event per microsecond near each, and some between them."""
    period = counter.period_us
    # From the first period's beginning: faery takes a first TIME_HIGH of 4,094 or 4,095 in EVT 3 for a step back.
    t = [np.arange(0, period, max(period // 40, 1))[:40], np.arange(max(period - 300, 0), period + 300)]
    for k in range(1, counter.rounds + 1):
        t.append(np.arange(k * period + 1_000, (k + 1) * period - 1_000, max(period // 40, 1))[:60])
        t.append((k + 1) * period + np.arange(-300, 300))
    t = np.sort(np.concatenate(t))
    t = t[(t >= 0) & (t <= counter.t_max_us)]
    random = np.random.default_rng(24)
    return events(t, random.integers(0, size[0], len(t)), random.integers(0, size[1], len(t)),
                  random.integers(0, 2, len(t)))


MAKE = {
    "random": random_kind,
    "vectors": vectors_kind,
    "gaps": gaps_kind,
    "roll-overs": roll_overs_kind,
    "empty": lambda size, counter: np.empty(0, DTYPE),
}


class Counter:
    """The period of a format's counter of time, and what times its writer takes."""

    def __init__(self, period_us, gap_max_us=None, t_max_us=1 << 60, rounds=2):
        self.period_us, self.t_max_us, self.rounds = period_us, t_max_us, rounds
        # Longer silences are refused.
        self.gap_max_us = gap_max_us or 1 << 60


HD, DAVIS, DVS128 = (1280, 720), (346, 260), (128, 128)
# 71.6 minutes; a writer whose reader could not tell a longer gap from a step back refuses it.
HALF = Counter(1 << 32, gap_max_us=(1 << 31) - 1)
# Without a counter; times pass 2^32.
NONE = Counter(1 << 32)

# Ending, size and counter of each format.
WRITERS = {
    "EVT 2": ("evt2.raw", HD, Counter(1 << 34)),
    "EVT 2.1": ("evt21.raw", HD, Counter(1 << 34)),
    "EVT 3": ("raw", HD, Counter(1 << 24)),
    "EVT 4": ("evt4.raw", HD, Counter(1 << 34)),
    "DAT": ("dat", HD, HALF),
    "AEDAT 2, DVS128": ("aedat", DVS128, HALF),
    "AEDAT 2, DAVIS240": ("aedat", (240, 180), HALF),
    "AEDAT 4": ("aedat4", DAVIS, NONE),
    "Event Stream": ("es", DAVIS, Counter(127)),
    "N-MNIST": ("bin", (256, 240), Counter(1 << 23, t_max_us=(1 << 23) - 1)),
    "ROS 1 bag": ("bag", DAVIS, NONE),
    "MCAP": ("mcap", DAVIS, NONE),
    "db3": ("db3", DAVIS, NONE),
    # Its index has an entry for each millisecond.
    "HDF5": ("h5", DAVIS, Counter(1 << 32, gap_max_us=1 << 28, rounds=1)),
    "Parquet": ("parquet", DAVIS, NONE),
    "Arrow": ("arrow", DAVIS, NONE),
    "Feather": ("feather", DAVIS, NONE),
    "Arrow stream": ("arrows", DAVIS, NONE),
    "npz": ("npz", DAVIS, NONE),
    "npy": ("npy", DAVIS, NONE),
    "MATLAB": ("mat", DAVIS, NONE),
    "csv": ("csv", DAVIS, NONE),
    "text": ("txt", DAVIS, NONE),
}


# What reads them: each takes the path and the size.


def by_expelliarmus(encoding):
    def read(path, _):
        array = expelliarmus.Wizard(encoding=encoding).read(path)
        # It gives None for a file without events.
        return np.empty(0, DTYPE) if array is None else events(array["t"], array["x"], array["y"], array["p"])

    return read


def by_evt3(path, _):
    array = evt3.decode_file(str(path))
    return events(*(np.asarray(getattr(array, name)) for name in ("timestamp", "x", "y", "polarity")))


def by_evlib(path, _):
    frame = evlib.load_events(str(path), sort=False).collect()
    t = frame["t"]
    t = t.dt.total_microseconds() if "Duration" in str(t.dtype) else t
    return events(t.to_numpy(), frame["x"].to_numpy(), frame["y"].to_numpy(), frame["polarity"].to_numpy())


def by_aedat(path, _):
    packets = [packet["events"] for packet in aedat.Decoder(str(path)) if "events" in packet]
    return joined([[packet[name] for name in ("t", "x", "y", "on")] for packet in packets])


def by_dv_processing(path, size):
    recording = dv_processing.io.MonoCameraRecording(str(path))
    if recording.getEventResolution() != size:
        raise ValueError(f"size {recording.getEventResolution()}")
    parts = []
    while (batch := recording.getNextEventBatch()) is not None:
        if batch.size():
            array = batch.numpy()
            parts.append([array[name] for name in ("timestamp", "x", "y", "polarity")])
    return joined(parts)


def by_dv_legacy(path, _):
    with dv_legacy.LegacyAedatFile(str(path)) as file:
        rows = [(event.timestamp, event.x, event.y, event.polarity) for event in file]
    t, x, y, p = np.array(rows, np.int64).reshape(-1, 4).T
    # It gives the bits of x, which jAER counts from the right.
    return events(t, 239 - x, y, p)


def by_event_stream(path, size):
    with event_stream.Decoder(str(path)) as decoder:
        parts = [[part["t"], part["x"], size[1] - 1 - part["y"], part["on"]] for part in decoder]
    return joined(parts)


def by_tonic(function, arrange=lambda t, x, y, p: (t, x, y, p)):
    def read(path, _):
        array = getattr(tonic, function)(str(path))[1]
        return events(*arrange(*(array[name].astype(np.int64) for name in "txyp")))

    return read


def by_tonic_mnist(path, _):
    array = tonic.read_mnist_file(path, dtype=tonic.events_struct)
    return events(*(array[name] for name in "txyp"))


def by_rosbags(path, size):
    if path.suffix == ".mcap":
        count = sum(1 for _ in ros_bags.by_mcap(path))
        ros_bags.describe(path, ros_bags.METADATA.format(file=path.name, count=count))
    whole = path.parent if path.suffix == ".mcap" else path
    return packets_of(ros_bags.by_rosbags(whole, path.suffix[1:]), size)


def by_mcap(path, size):
    return packets_of(ros_bags.by_mcap(path), size)


def packets_of(messages, size):
    array = ros_bags.collect(messages, size)
    if array is None:
        raise ValueError("other messages")
    return events(*array.T)


def by_h5py(path, _):
    with h5py.File(path) as file:
        columns = [file[f"events/{name}"][:] for name in "txyp"]
        return events(columns[0] + file["t_offset"][()], *columns[1:])


def of_columns(read):
    def columns(path, _):
        table = read(path)
        if pd and isinstance(table, pd.DataFrame) or pl and isinstance(table, pl.DataFrame):
            # A text without events has its size in the names of its columns: x@346.
            table = renamed(table, {name: name.split("@")[0] for name in table.columns})
        return events(*(np.asarray(table[name]) for name in "txyp"))

    return columns


def renamed(table, names):
    return table.rename(columns=names) if pd and isinstance(table, pd.DataFrame) else table.rename(names)


def by_scipy(path, _):
    td = scipy_io.loadmat(path)["TD"][0, 0]
    return events(*(td[name].ravel() for name in ("ts", "x", "y", "p")))


def by_numpy_text(path, _):
    with open(path) as file:
        # It warns of a file without rows.
        with warnings.catch_warnings(action="ignore"):
            rows = np.loadtxt(file, dtype=np.int64, ndmin=2).reshape(-1, 4)
    return events(*rows.T)


def by_csv(path, _):
    with open(path, newline="") as file:
        rows = [[int(row[name]) for name in "txyp"] for row in csv.DictReader(file)]
    return events(*np.array(rows, np.int64).reshape(-1, 4).T)


def quiet(name):
    """A package, which may print while it is imported, and not the script of the same name beside this one."""
    here = sys.path.pop(0)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            return __import__(name, fromlist=["_"])
    except ImportError:
        print(f"absent: {name}")
    finally:
        sys.path.insert(0, here)


def module_alone(found_in, name):
    """A module of a package without what the rest of the package needs."""
    found = importlib.util.find_spec(found_in)
    if not found:
        print(f"absent: {found_in}")
        return None
    path = pathlib.Path(found.origin).with_name(name)
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


faery = comparison.faery
expelliarmus, evt3, evlib, aedat = (quiet(name) for name in ("expelliarmus", "evt3", "evlib", "aedat"))
dv_processing, event_stream = quiet("dv_processing"), quiet("event_stream")
dv_legacy = module_alone("dv", "LegacyAedatFile.py")
tonic = module_alone("tonic", "io.py")
h5py, pl, pd, scipy_io = (quiet(name) for name in ("h5py", "polars", "pandas", "scipy.io"))
pa = quiet("pyarrow")
ipc, pq, feather = (quiet(f"pyarrow.{name}") if pa else None for name in ("ipc", "parquet", "feather"))
fastparquet = quiet("fastparquet")
try:
    import ros_bags
except SystemExit:
    ros_bags = None

if tonic:
    # Its readers of one camera take two of the three values that its reader of headers gives: ValueError.
    header_of_tonic = tonic.read_aedat_header_from_file
    tonic.read_aedat_header_from_file = lambda path: header_of_tonic(path)[:2]


# jAER, whose layouts these are, counts columns from the right and calls the lower bits x; tonic gives the bits as they
# are, and calls the upper ones x. In a DVS128 the lowest bit is 1 for OFF.


def from_bits_davis240(t, upper, lower, bit):
    return t, 239 - lower, upper, bit


def from_bits_dvs128(t, upper, lower, bit):
    return t, 127 - lower, upper, 1 - bit


# Writer, module, its package, reader.
READERS = [
    ("EVT 2", faery, "faery", comparison.faerys),
    ("EVT 2", expelliarmus, "expelliarmus", by_expelliarmus("evt2")),
    ("EVT 2", evlib, "evlib", by_evlib),
    ("EVT 2.1", evlib, "evlib", by_evlib),
    ("EVT 3", faery, "faery", comparison.faerys),
    ("EVT 3", expelliarmus, "expelliarmus", by_expelliarmus("evt3")),
    ("EVT 3", evt3, "evt3", by_evt3),
    ("EVT 3", evlib, "evlib", by_evlib),
    ("DAT", faery, "faery", comparison.faerys),
    ("DAT", expelliarmus, "expelliarmus", by_expelliarmus("dat")),
    ("AEDAT 2, DVS128", tonic, "tonic", by_tonic("read_dvs_128", from_bits_dvs128)),
    ("AEDAT 2, DAVIS240", tonic, "tonic", by_tonic("read_dvs_346mini", from_bits_davis240)),
    ("AEDAT 2, DAVIS240", dv_legacy, "dv", by_dv_legacy),
    ("AEDAT 4", aedat, "aedat", by_aedat),
    ("AEDAT 4", faery, "faery", comparison.faerys),
    ("AEDAT 4", dv_processing, "dv_processing", by_dv_processing),
    ("Event Stream", faery, "faery", comparison.faerys),
    ("Event Stream", event_stream, "event_stream", by_event_stream),
    ("N-MNIST", tonic, "tonic", by_tonic_mnist),
    ("ROS 1 bag", ros_bags, "rosbags", by_rosbags),
    ("MCAP", ros_bags, "rosbags", by_rosbags),
    ("MCAP", ros_bags, "mcap", by_mcap),
    ("db3", ros_bags, "rosbags", by_rosbags),
    ("HDF5", h5py, "h5py", by_h5py),
    ("Parquet", pq, "pyarrow", of_columns(pq and pq.read_table)),
    ("Parquet", pl, "polars", of_columns(pl and pl.read_parquet)),
    ("Parquet", fastparquet, "fastparquet", of_columns(lambda path: fastparquet.ParquetFile(path).to_pandas())),
    ("Arrow", ipc, "pyarrow", of_columns(lambda path: ipc.open_file(path).read_all())),
    ("Arrow", pl, "polars", of_columns(pl and pl.read_ipc)),
    ("Feather", feather, "pyarrow", of_columns(feather and feather.read_table)),
    ("Feather", pl, "polars", of_columns(pl and pl.read_ipc)),
    ("Arrow stream", ipc, "pyarrow", of_columns(lambda path: ipc.open_stream(path).read_all())),
    ("Arrow stream", pl, "polars", of_columns(pl and pl.read_ipc_stream)),
    ("npz", np, "numpy", of_columns(np.load)),
    ("npy", np, "numpy", of_columns(np.load)),
    ("MATLAB", scipy_io, "scipy", by_scipy),
    ("csv", pd, "pandas", of_columns(pd and pd.read_csv)),
    ("csv", pl, "polars", of_columns(pl and pl.read_csv)),
    ("csv", faery, "faery", comparison.faerys),
    ("csv", csv, "Python", by_csv),
    ("text", np, "numpy", by_numpy_text),
]


# What packages get wrong by themselves: a word for the table, and what is compared all the same.


def without(*names):
    def lens(array):
        return array[[name for name in array.dtype.names if name not in names]]

    return lens


def modulo(period_us):
    def lens(array):
        array = array.copy()
        array["t"] %= period_us
        return array

    return lens


ALL = tuple(KINDS[:-1])
ONE_WRAP = ("gaps", "roll-overs")


def known(writer, package, kinds, word, lens):
    return {(writer, package, kind): (word, lens) for kind in kinds}


KNOWN = {
    # It knows no roll-over of the 34 bits of time.
    **known("EVT 2", "expelliarmus", ONE_WRAP, "times modulo 2^34", modulo(1 << 34)),
    # It counts a roll-over again at the first TIME_HIGH of the new period that is not 0; not so in EVT 2.1.
    **known("EVT 2", "evlib", ONE_WRAP, "times modulo 2^34", modulo(1 << 34)),
    # A TIME_LOW below the previous one adds 4,096 us until the next TIME_HIGH, although that has come already: so
    # it does in recordings of cameras.
    **known("EVT 3", "expelliarmus", ALL, "times modulo 4,096", modulo(1 << 12)),
    # It gives the 32 bits as they are.
    **known("AEDAT 2, DVS128", "tonic", ONE_WRAP, "times modulo 2^32", modulo(1 << 32)),
    **known("AEDAT 2, DAVIS240", "tonic", ONE_WRAP, "times modulo 2^32", modulo(1 << 32)),
    # It adds 2^31 us for a roll-over of 32 bits.
    **known("AEDAT 2, DAVIS240", "dv", ONE_WRAP, "times modulo 2^31", modulo(1 << 31)),
    # Differences of 2^31 and more in DELTA_BINARY_PACKED, also in files of pyarrow.
    **known("Parquet", "fastparquet", ["gaps"], "x, y, p", without("t")),
}


def convert(source, path, size):
    run = subprocess.run(
        [comparison.eecvs, "convert", "--overwrite", source, path, "--width", str(size[0]), "--height", str(size[1])],
        capture_output=True, text=True,
    )
    return run.stderr if run.returncode else ""


def save(path, array, size):
    p = array["p"].astype(np.uint8)
    np.savez(path, x=array["x"], y=array["y"], t=array["t"].astype(np.int64), p=p, width=size[0], height=size[1])


def compare(name, read, path, size, want, known):
    """One cell of the table."""
    try:
        got, trouble = read(path, size), ""
    except Exception as error:
        got, trouble = None, f"{type(error).__name__}: {error}"
    if got is not None and len(got) == len(want) and np.array_equal(got, want):
        note = f", although: {known[0]}" if known else ""
        print(f"ok       {name}: {len(want)} events{note}")
        return "same"
    if known:
        word, lens = known
        if got is not None and np.array_equal(lens(got), lens(want)):
            print(f"known    {name}: {word}")
            return word
    if got is None:
        comparison.failures += 1
        print(f"differs  {name}: {trouble}")
    else:
        comparison.check(name, got, want)
    return "DIFFERS"


def version(package):
    return importlib.metadata.version(package) if package != "Python" else sys.version.split()[0]


def table(rows):
    lines = ["| writer | reader | " + " | ".join(KINDS) + " |", "|---" * (2 + len(KINDS)) + "|"]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def made(folder):
    rows = []
    for writer, (ending, size, counter) in WRITERS.items():
        readers = [entry[1:] for entry in READERS if entry[0] == writer and entry[1]]
        cells = {entry[1]: [] for entry in readers}
        for kind in KINDS:
            want = MAKE[kind](size, counter)
            own = folder / f"{writer} {kind}"
            own.mkdir()
            source, path = own / "source.npz", own / f"ours.{ending}"
            save(source, want, size)
            error = convert(source, path, size)
            if "--features" in error:
                print(f"absent: the command's {writer}")
                break
            if error:
                sys.exit(f"{writer}, {kind}: {error}")
            back = own / "back.npz"
            error = convert(path, back, size)
            if error:
                sys.exit(f"{writer}, {kind}, read back: {error}")
            with np.load(back) as arrays:
                comparison.check(f"{writer}, {kind}, by the command", events(*(arrays[c] for c in "txyp")), want)
            for _, package, read in readers:
                name = f"{writer}, {kind}, by {package}"
                known = KNOWN.get((writer, package, kind))
                cells[package].append(compare(name, read, path, size, want, known))
        if counter.gap_max_us < counter.period_us and writer != "HDF5":
            source = folder / "refused.npz"
            last = counter.period_us - 10
            save(source, events([last, last + counter.gap_max_us + 2], [1, 1], [1, 1], [1, 1]), size)
            error = convert(source, folder / f"refused.{ending}", size)
            comparison.verdict(f"{writer}: a longer silence is refused", bool(error))
        rows += [[writer, f"{package} {version(package)}", *cells[package]] for package in cells if cells[package]]
    if out:
        out.write_text(table(rows))


if __name__ == "__main__":
    out = pathlib.Path(sys.argv.pop(2)) if len(sys.argv) > 2 else None
    comparison.run(__doc__, None, made)

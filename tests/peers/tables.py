"""HDF5, Arrow and Parquet files against their libraries: h5py with hdf5plugin, and pyarrow.

    python tests/peers/tables.py EECVS [RECORDING ...]

The events of each of the recordings, and random ones, are written by the command and read by the libraries;
random ones are written by the libraries, in every compression and encoding that is read, and read by the command.
comparison.py says what is printed.
"""

import itertools
import pathlib
import subprocess
import sys
import tempfile

import comparison
from comparison import EVENTS, np, package

SIZE = (1280, 720)

h5py = package("h5py")
hdf5plugin = package("hdf5plugin") if h5py else None
pa = package("pyarrow")
ipc = package("pyarrow.ipc") if pa else None
pq = package("pyarrow.parquet") if pa else None
if not (h5py or pa):
    sys.exit(77)


def random_events():
    """t, x, y, p: steps back, repetitions that compress and noise that does not."""
    random = np.random.default_rng(7)
    t = np.cumsum(random.integers(-3, 25, EVENTS)) + 1_600_000_000_000_000
    x, y = random.integers(0, SIZE[0], EVENTS), random.integers(0, SIZE[1], EVENTS)
    p = random.integers(0, 2, EVENTS)
    x[:40_000] = np.arange(40_000) // 4 % 100
    y[20_000:60_000] = np.repeat(np.arange(400), 100)
    p[:50_000] = 1
    return events(t, x, y, p)


def events(t, x, y, p):
    """Columns of the types that the command writes to .npz."""
    return [np.asarray(c).astype(of) for c, of in zip((t, x, y, p), ("i8", "u2", "u2", "u1"))]


def check(name, got, want):
    if all(len(a) == len(b) and np.array_equal(a, b) for a, b in zip(got, want)):
        print(f"ok       {name}: {len(want[0])} events")
        return
    comparison.failures += 1
    print(f"differs  {name}: {[len(c) for c in got]} and {[len(c) for c in want]} values")


def convert(source, path):
    size = ["--width", str(SIZE[0]), "--height", str(SIZE[1])]
    run = subprocess.run([comparison.eecvs, "convert", "--overwrite", source, path, *size],
                         capture_output=True, text=True)
    return run.stderr if run.returncode != 0 else ""


def ours(name, path, want):
    """Checks the events of a file as the command reads them."""
    out = folder / "ours.npz"
    error = convert(path, out)
    if error:
        comparison.failures += 1
        print(f"differs  {name}: {error.strip()}")
        return
    with np.load(out) as arrays:
        check(name, [arrays[c] for c in "txyp"], want)


def theirs(name, source, want):
    """Checks what the libraries read of files of the command."""
    for ending in ["h5"] * bool(h5py) + ["arrow", "feather", "arrows", "parquet"] * bool(pa):
        path = folder / f"ours.{ending}"
        error = convert(source, path)
        if error:
            sys.exit(error)
        if ending == "h5":
            with h5py.File(path) as file:
                columns = {c: file[f"events/{c}"][:] for c in "txyp"}
                highest = np.maximum.accumulate(columns["t"])
                index = np.searchsorted(highest, np.arange(0, highest[-1] + 1, 1000))
                check(f"{name}: ms_to_idx", [file["ms_to_idx"][:]], [index])
                columns["t"] = columns["t"] + file["t_offset"][()]
        elif ending == "parquet":
            columns = pq.read_table(path)
        else:
            new = ipc.open_stream if ending == "arrows" else ipc.open_file
            columns = new(path).read_all()
            columns.validate(full=True)
        check(f"{name}: our .{ending}", events(*(np.asarray(columns[c]) for c in "txyp")), want)


def hdf5_files(want):
    packed = {"lzf": {"compression": "lzf"}, "gzip": {"compression": "gzip", "shuffle": True}}
    if hdf5plugin:
        codecs, shuffles = ["blosclz", "lz4", "lz4hc", "snappy", "zlib", "zstd"], [0, 1, 2]
        for codec, shuffle, level in itertools.product(codecs, shuffles, [1, 5, 9]):
            options = hdf5plugin.Blosc(cname=codec, shuffle=shuffle, clevel=level)
            packed[f"blosc {codec} shuffle {shuffle} level {level}"] = dict(options)
        codecs, two = ["blosclz", "lz4", "lz4hc", "zlib", "zstd"], hdf5plugin.Blosc2
        filters = {"none": two.NOFILTER, "bytes": two.SHUFFLE, "bits": two.BITSHUFFLE, "delta": two.DELTA}
        for codec, (filter, number), level in itertools.product(codecs, filters.items(), [0, 5]):
            options = two(cname=codec, clevel=level, filters=number)
            packed[f"blosc2 {codec} {filter} level {level}"] = dict(options)
        for codec, elements in itertools.product(["none", "lz4", "zstd"], [0, 64, 1000]):
            options = hdf5plugin.Bitshuffle(nelems=elements, cname=codec)
            packed[f"bitshuffle {codec} of {elements}"] = dict(options)
        packed["lz4"] = dict(hdf5plugin.LZ4())
        packed["lz4 of 1000 bytes"] = dict(hdf5plugin.LZ4(nbytes=1000))
        packed["zstd"] = dict(hdf5plugin.Zstd())
    t, x, y, p = want
    offset = int(t.min())
    for (name, options), chunk in itertools.product(packed.items(), [4096, 10_000, 1 << 16]):
        path = folder / "theirs.h5"
        with h5py.File(path, "w") as file:
            columns = {"t": (t - offset).astype("u4"), "x": x, "y": y, "p": p}
            for column, values in columns.items():
                file.create_dataset(f"events/{column}", data=values, chunks=(chunk,), **options)
            file["t_offset"] = np.int64(offset)
        ours(f"h5py, {name}, chunks of {chunk}", path, want)


def tables(want):
    t, x, y, p = want
    plain = {"t": t, "x": x, "y": y, "p": p}
    kinds = {
        "plain": plain,
        "bool": plain | {"p": p.astype(bool)},
        "p 1, -1": plain | {"p": np.where(p == 1, 1, -1).astype("i1")},
        "timestamp[us]": plain | {"t": pa.array(t).cast(pa.timestamp("us"))},
        "timestamp[ns]": plain | {"t": pa.array(t * 1000).cast(pa.timestamp("ns"))},
        "floats": plain | {"x": x.astype("f8"), "y": y.astype("f4")},
        "uint64": plain | {"t": t.astype("u8")},
        "other columns": {
            "text": [str(i) for i in range(len(t))],
            "list": [[1, 2], []] * (len(t) // 2),
            "struct": [{"a": 1, "b": {"c": "d"}}] * len(t),
            "timestamp_ns": t * 1000, "xs": x, "ys": y, "polarity": p,
        },
    }
    return {name: pa.table(columns) for name, columns in kinds.items()}


def arrow_files(want):
    for (name, table), codec, stream in itertools.product(
        tables(want).items(), [None, "lz4", "zstd"], [False, True]
    ):
        path = folder / "theirs.arrow"
        new = ipc.new_stream if stream else ipc.new_file
        with new(path, table.schema, options=ipc.IpcWriteOptions(compression=codec)) as writer:
            writer.write_table(table, max_chunksize=30_001)
        ours(f"pyarrow, {'stream' if stream else 'file'}, {name}, {codec}", path, want)


def parquet_files(want):
    options = {
        f"{codec}, pages {version}": {"compression": codec, "data_page_version": version}
        for codec in ["none", "snappy", "gzip", "zstd", "lz4"] for version in ["1.0", "2.0"]
    }
    options["no dictionary"] = {"use_dictionary": False}
    options["checksums"] = {"write_page_checksum": True}
    options["small pages and groups"] = {"data_page_size": 500, "row_group_size": 7001}
    for name, table in tables(want).items():
        more = {}
        if name in ["plain", "timestamp[us]"]:
            for encoding in ["DELTA_BINARY_PACKED", "BYTE_STREAM_SPLIT", "PLAIN"]:
                columns = {column: encoding for column in "txy"}
                more[encoding] = {"use_dictionary": False, "column_encoding": columns}
        for option, chosen in (options | more).items():
            path = folder / "theirs.parquet"
            pq.write_table(table, path, **chosen)
            ours(f"pyarrow, Parquet, {name}, {option}", path, want)


def recording(path):
    global folder
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        source = folder / "recording.npz"
        error = convert(path, source)
        if error:
            sys.exit(error)
        with np.load(source) as arrays:
            want = events(*(arrays[c] for c in "txyp"))
        theirs(path.name, path, want)


def made(empty):
    global folder
    folder = empty
    want = random_events()
    if h5py:
        hdf5_files(want)
    if pa:
        arrow_files(want)
        parquet_files(want)
    source = folder / "random.npz"
    np.savez(source, **dict(zip("txyp", want)))
    theirs("random events", source, want)


if __name__ == "__main__":
    comparison.run(__doc__, recording, made)

"""Datasets of events, written and read by h5py through the filter.

    HDF5_PLUGIN_PATH=... python h5py_files.py FOLDER

The files are read by a process of their own, which has no part in writing them. Prints a line that begins with "ok" for
each file; its exit status is 77 without h5py.
"""

import hashlib
import json
import pathlib
import subprocess
import sys

try:
    import h5py
    import numpy as np
except ImportError as error:
    print(f"skipped: {error}")
    sys.exit(77)

COUNT = 200_000
TYPES = {
    "prophesee": np.dtype({"names": ["x", "y", "p", "t"], "formats": ["<u2", "<u2", "<i2", "<i8"],
                           "offsets": [0, 2, 4, 8], "itemsize": 16}),
    "packed": np.dtype([("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "?")]),
    "wide": np.dtype([("t", "<i8"), ("x", "<i4"), ("y", "<i4"), ("p", "<i4")]),
}


def eecvs(dtype, rows, effort=0):
    fields = [dtype.fields[name] for name in "txyp"]
    values = [number for kind, offset in fields for number in (offset, kind.itemsize)]
    return dict(chunks=(rows,), compression=494, compression_opts=(dtype.itemsize, *values, effort, rows))


def events(dtype):
    random = np.random.default_rng(7)
    rows = np.zeros(COUNT, dtype)
    rows["t"] = 1_600_000_000_000_000 + np.cumsum(random.integers(0, 5, COUNT))
    rows["x"], rows["y"] = random.integers(0, 640, COUNT), random.integers(0, 480, COUNT)
    rows["p"] = random.integers(0, 2, COUNT)
    return rows


def digest(rows):
    return hashlib.sha256(np.ascontiguousarray(rows).tobytes()).hexdigest()


def write(folder):
    """Writes the files; returns the name, the digest of the rows and the most bits of a row of each."""
    made = []

    def note(name, rows, most):
        made.append((name, digest(rows), most, len(rows)))

    for name, dtype in TYPES.items():
        rows = events(dtype)
        for effort in (0, 1, 3):
            path = f"{name}-{effort}.h5"
            with h5py.File(folder / path, "w") as file:
                file.create_dataset("CD/events", data=rows, **eecvs(dtype, 1 << 16, effort))
            note(path, rows, 28)
    # Written part by part: chunks that are filled up later, and read again for that.
    dtype = TYPES["packed"]
    rows = events(dtype)
    with h5py.File(folder / "grown.h5", "w") as file:
        dataset = file.create_dataset("CD/events", (0,), dtype, maxshape=(None,), **eecvs(dtype, 1 << 15))
        for begin in range(0, COUNT, 30_001):
            part = rows[begin:begin + 30_001]
            dataset.resize(begin + len(part), 0)
            dataset[begin:] = part
    note("grown.h5", rows, 28)
    # A table of numbers, whose rows are t, x, y, p; and none of them in order of time.
    table = np.stack([rows[name].astype("<i8") for name in "txyp"], 1)
    table[:, 3] = table[:, 3] * 2 - 1
    table[:, 0] = table[::-1, 0]
    with h5py.File(folder / "table.h5", "w") as file:
        file.create_dataset("CD/events", data=table, chunks=(1 << 14, 4), compression=494,
                            compression_opts=(32, 0, 8, 8, 8, 16, 8, 24, 8))
    note("table.h5", table, 257)
    damage(folder, dtype)
    return made


def damage(folder, dtype):
    """A bit of a chunk, and a chunk of another dataset that has fewer rows: both are errors."""
    rows = events(dtype)[:5000]
    with h5py.File(folder / "damaged.h5", "w") as file:
        whole = file.create_dataset("whole", data=rows, **eecvs(dtype, 5000))
        part = file.create_dataset("part", data=rows[:2000], **eecvs(dtype, 2000))
        mask, chunk = whole.id.read_direct_chunk((0,))
        wrong = bytearray(chunk)
        wrong[1] ^= 1
        for name, chunk in ("bit", bytes(wrong)), ("fewer", part.id.read_direct_chunk((0,))[1]):
            dataset = file.create_dataset(name, (5000,), dtype, **eecvs(dtype, 5000))
            dataset.id.write_direct_chunk((0,), chunk, mask)
    with h5py.File(folder / "damaged.h5") as file:
        assert digest(file["whole"][:]) == digest(rows)
        for name in "bit", "fewer":
            try:
                file[name][:]
            except OSError as error:
                print(f"ok       damaged.h5, {name}: {error}")
            else:
                raise AssertionError(f"damaged.h5, {name}: read")


def read(folder, made):
    for name, want, most, count in made:
        with h5py.File(folder / name) as file:
            dataset = file["CD/events"]
            rows = dataset[:]
            assert digest(rows) == want, f"{name}: the rows differ"
            part = dataset[70_000:70_010]
            assert digest(part) == digest(rows[70_000:70_010]), f"{name}: a part differs"
            bits = dataset.id.get_storage_size() * 8 / count
            assert bits < most, f"{name}: {bits} bits"
        print(f"ok       {name}: {count} rows, {bits:.2f} bits each")


if __name__ == "__main__":
    folder = pathlib.Path(sys.argv[1])
    if len(sys.argv) > 2:
        read(folder, json.loads(sys.argv[2]))
    else:
        made = write(folder)
        sys.exit(subprocess.run([sys.executable, __file__, str(folder), json.dumps(made)]).returncode)

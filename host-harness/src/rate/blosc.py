"""Writes the columns t, x, y, p of this folder to events.h5, or reads them back; prints the seconds that took."""

import sys
import time

import h5py
import hdf5plugin
import numpy

COLUMNS = {"t": "<u8", "x": "<u2", "y": "<u2", "p": "u1"}

if sys.argv[1] == "write":
    columns = {name: numpy.fromfile(name, kind) for name, kind in COLUMNS.items()}
    # As in DSEC: times of 32 bits from the first one on, if they fit.
    first = columns["t"][0] if len(columns["t"]) else numpy.uint64(0)
    times = columns["t"] - first
    if not len(times) or times.max() < 1 << 32:
        times = times.astype("<u4")
    columns["t"] = times
    started = time.perf_counter()
    with h5py.File("events.h5", "w") as file:
        file["t_offset"] = first
        for name, column in columns.items():
            blosc = hdf5plugin.Blosc(cname="zstd", clevel=9, shuffle=hdf5plugin.Blosc.SHUFFLE)
            file.create_dataset(f"events/{name}", data=column, chunks=True, **blosc)
    print(time.perf_counter() - started)
else:
    started = time.perf_counter()
    with h5py.File("events.h5", "r") as file:
        first = file["t_offset"][()]
        columns = {name: file[f"events/{name}"][:] for name in COLUMNS}
    seconds = time.perf_counter() - started
    columns["t"] = columns["t"].astype("<u8") + first
    for name, kind in COLUMNS.items():
        columns[name].astype(kind).tofile(name)
    print(seconds)

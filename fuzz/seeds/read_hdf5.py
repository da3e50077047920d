#!/usr/bin/env python3
"""Writes the seeds in fuzz/seeds/read_hdf5/, which host-harness/tests/formats_hdf5.rs reads as well.

    pip install h5py hdf5plugin
    python3 fuzz/seeds/read_hdf5.py
"""

from pathlib import Path

import h5py
import hdf5plugin
import numpy as np

FOLDER = Path(__file__).parent / "read_hdf5"
I = np.arange(300)
X, Y, ON = I * 7 % 64, I * 3 % 48, I % 3 == 0


def mvsec(name, version, compression="gzip", **storage):
    """davis/left/events: x, y, t in seconds, p = 1 or -1."""
    seconds = (1506117862200001 + I * 17) / 1e6
    rows = np.stack([X, Y, seconds, np.where(ON, 1.0, -1.0)], axis=1)
    with h5py.File(FOLDER / name, "w", libver=version) as file:
        file.create_dataset("davis/left/events", data=rows, compression=compression, **storage)


mvsec("mvsec_earliest.h5", "earliest", chunks=(100, 4), shuffle=True)
mvsec("mvsec_latest.h5", "latest", chunks=(100, 4), shuffle=True)
mvsec("mvsec_unlimited.h5", "latest", chunks=(128, 4), maxshape=(None, 4))

with h5py.File(FOLDER / "dsec_latest.h5", "w", libver="latest") as file:
    columns = {"x": X.astype("u2"), "y": Y.astype("u2"), "t": (I * 17).astype("u4"), "p": ON}
    for name, column in columns.items():
        file.create_dataset(f"events/{name}", data=column, chunks=(64,), compression="gzip")
    file["t_offset"] = np.int64(1000000)
    file["ms_to_idx"] = np.arange(6, dtype="u8")

with h5py.File(FOLDER / "compound_latest.h5", "w", libver="latest") as file:
    fields = [("x", "<u2"), ("y", "<u2"), ("p", "?"), ("t", "<i8")]
    rows = np.zeros(len(I), dtype=fields)
    rows["x"], rows["y"], rows["p"], rows["t"] = X, Y, ON, 1000000 + I * 17
    file.create_dataset("events", data=rows, chunks=(100,), compression="gzip")


def dsec(name, **packed):
    """events/x, y, t in us, p, packed by a filter."""
    with h5py.File(FOLDER / name, "w", libver="latest") as file:
        columns = {"x": X.astype("u2"), "y": Y.astype("u2"), "t": (I * 17).astype("u4"), "p": ON.astype("u1")}
        for column, numbers in columns.items():
            file.create_dataset(f"events/{column}", data=numbers, chunks=(300,), **packed)
        file["t_offset"] = np.int64(1000000)
        file["ms_to_idx"] = np.searchsorted(I * 17, np.arange(0, 5100, 1000)).astype("u8")


for codec in ["blosclz", "lz4", "zlib", "zstd", "snappy"]:
    dsec(f"blosc_{codec}.h5", **hdf5plugin.Blosc(cname=codec, clevel=9, shuffle=hdf5plugin.Blosc.SHUFFLE))
dsec("blosc_bits.h5", **hdf5plugin.Blosc(cname="lz4", clevel=5, shuffle=hdf5plugin.Blosc.BITSHUFFLE))
dsec("lzf.h5", compression="lzf", shuffle=True)
dsec("lz4.h5", **hdf5plugin.LZ4(nbytes=256))
dsec("zstandard.h5", **hdf5plugin.Zstd())

for codec in ["blosclz", "lz4", "zlib", "zstd"]:
    dsec(f"blosc2_{codec}.h5", **hdf5plugin.Blosc2(cname=codec, clevel=9, filters=hdf5plugin.Blosc2.SHUFFLE))
dsec("blosc2_bits.h5", **hdf5plugin.Blosc2(cname="lz4", clevel=5, filters=hdf5plugin.Blosc2.BITSHUFFLE))
dsec("blosc2_delta.h5", **hdf5plugin.Blosc2(cname="zstd", clevel=5, filters=hdf5plugin.Blosc2.DELTA))
dsec("blosc2_stored.h5", **hdf5plugin.Blosc2(clevel=0))
mvsec("blosc2_table.h5", "latest", chunks=(100, 3), **hdf5plugin.Blosc2(cname="lz4", clevel=5))
dsec("bitshuffle.h5", **hdf5plugin.Bitshuffle(cname="none"))
dsec("bitshuffle_lz4.h5", **hdf5plugin.Bitshuffle(nelems=64, cname="lz4"))
dsec("bitshuffle_zstd.h5", **hdf5plugin.Bitshuffle(cname="zstd"))

#!/usr/bin/env python3
"""Writes the files beside it, which ../formats_layouts.rs reads: layouts that other people's tools write.

    pip install h5py numpy pandas polars pyarrow scipy
    python3 crates/event-files/tests/formats/layouts_data/make.py
"""

from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.feather as feather
import pyarrow.parquet as pq
from scipy.io import savemat

HERE = Path(__file__).parent
I = np.arange(300)
T, X, Y, ON = 1_000_000 + I * 17, I * 7 % 64, I * 3 % 48, I % 3 == 0
P = ON.astype("i1")
WORDS = np.where(ON, "ON", "OFF")


def table(t, **more):
    return pa.table({"t": t, "x": X.astype("u2"), "y": Y.astype("u2"), "p": P} | more)


# Units that only Arrow's schema states, in Parquet's footer.
for unit, per_us in [("us", 1), ("ns", 1000)]:
    t = pa.array(T * per_us, pa.int64()).cast(pa.duration(unit))
    pq.write_table(table(t), HERE / f"duration_{unit}.parquet")
frame = pd.DataFrame({"t": pd.to_timedelta(T * 1000, unit="ns"), "x": X, "y": Y, "p": P})
frame.to_parquet(HERE / "pandas_timedelta.parquet")
pl.DataFrame({"t": pl.Series(T).cast(pl.Duration("us")), "x": X, "y": Y, "p": P}).write_parquet(
    HERE / "polars_duration.parquet"
)
pq.write_table(table(T), HERE / "brotli.parquet", compression="brotli")
missing = pa.array([None if i == 7 else int(x) for i, x in enumerate(X)], pa.int64())
pq.write_table(table(T, x=missing), HERE / "null.parquet")
feather.write_feather(table(T, x=missing), HERE / "null.feather")
# Places in dictionaries, of numbers and of words.
words = table(pa.array(T).dictionary_encode(), p=pa.array(WORDS).dictionary_encode())
feather.write_feather(words, HERE / "dictionary.feather")
# No schema in front: the footer alone has it.
pl.DataFrame({"x": X.astype("i2"), "y": Y.astype("i2"), "t": T, "polarity": P}).write_ipc(HERE / "polars.arrow")


def columns(group, t, more=()):
    for name, values, of in [("t", t, "i8"), ("x", X, "u2"), ("y", Y, "u2"), ("p", P, "u1"), *more]:
        group.create_dataset(name, data=np.asarray(values).astype(of))


with h5py.File(HERE / "column_vectors.h5", "w") as file:
    columns(file.create_group("events"), T[:, None])
    for name in ["x", "y", "p"]:
        values = file["events"][name][:]
        del file["events"][name]
        file["events"][name] = values[:, None]
with h5py.File(HERE / "rows.h5", "w") as file:
    file["events"] = np.stack([T, X, Y, P]).astype("i4")
with h5py.File(HERE / "units.h5", "w") as file:
    columns(file.create_group("events"), T * 1000)
    file["events/t"].attrs["units"] = "ns"
with h5py.File(HERE / "size_beside.h5", "w") as file:
    columns(file.create_group("events"), T)
    file["events/width"], file["events/height"] = 1280, 720
with h5py.File(HERE / "sensor_resolution.h5", "w") as file:
    columns(file.create_group("events"), T)
    file.attrs["sensor_resolution"] = (720, 1280)
with h5py.File(HERE / "outlier.h5", "w") as file:
    columns(file.create_group("events"), T)
    file["events/width"], file["events/height"] = 1280, 720
    file["events/y"][7] = 33014
with h5py.File(HERE / "snntorch.h5", "w") as file:
    group = file.create_group("data/0")
    group["times"], group["addrs"] = T.astype("u4"), np.stack([X, Y, P], axis=1).astype("u1")
with h5py.File(HERE / "ddd.hdf5", "w") as file:
    file["dvs/timestamp"], file["dvs/data"] = np.arange(4), np.zeros((4, 64), "u1")
# MATLAB's -v7.3: everything is a double of two dimensions, and counts from 1.
with h5py.File(HERE / "v73.mat", "w", userblock_size=512) as file:
    for name, values in [("x", X + 1), ("y", Y + 1), ("p", ON + 1), ("ts", T)]:
        file[f"TD/{name}"] = values.astype("f8")[None, :]
with open(HERE / "v73.mat", "r+b") as file:
    file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")

td = {"x": (X + 1).astype("u2"), "y": (Y + 1).astype("u2"), "p": P, "ts": T.astype("u4")}
savemat(HERE / "one_based.mat", {"TD": td})
polarity = {"timeStamp": T.astype("u8")[:, None], "x": X[:, None], "y": Y[:, None], "polarity": P[:, None]}
savemat(HERE / "aedat_tools.mat", {"aedat": {"data": {"polarity": polarity}, "info": {"source": "Davis346"}}})

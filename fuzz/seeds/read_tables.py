#!/usr/bin/env python3
"""Writes the seeds in fuzz/seeds/read_arrow/ and read_parquet/, which crates/event-files/tests/formats/tables.rs
reads as well.

    pip install pyarrow
    python3 fuzz/seeds/read_tables.py
"""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.ipc as ipc
import pyarrow.parquet as pq

FOLDER = Path(__file__).parent
I = np.arange(300)
COLUMNS = {
    "t": pa.array(1000000 + I * 17),
    "x": pa.array((I * 7 % 64).astype("u2")),
    "y": pa.array((I * 3 % 48).astype("u2")),
    "p": pa.array(I % 3 == 0),
}
PLAIN = pa.table(COLUMNS)
SIZED = PLAIN.replace_schema_metadata({"width": "64", "height": "48"})
TYPES = pa.table({
    "name": pa.array([str(i) for i in I]),
    "parts": pa.array([[1, 2], []] * 150),
    "pair": pa.array([{"a": 1, "b": "c"}] * 300),
    "timestamp": COLUMNS["t"].cast(pa.timestamp("us")).cast(pa.timestamp("ns")),
    "xs": COLUMNS["x"].cast(pa.float32()),
    "ys": COLUMNS["y"].cast(pa.int64()),
    "polarity": pa.array(np.where(I % 3 == 0, 1, -1).astype("i1")),
})
SECONDS = PLAIN.set_column(0, "t", pa.array((1000000 + I * 17) / 1e6))
REQUIRED = PLAIN.cast(pa.schema([pa.field(f.name, f.type, False) for f in PLAIN.schema]))


def arrow(name, table, new=ipc.new_file, compression=None):
    options = ipc.IpcWriteOptions(compression=compression)
    with new(FOLDER / "read_arrow" / name, table.schema, options=options) as writer:
        writer.write_table(table, max_chunksize=128)


def parquet(name, table, **options):
    options = {"compression": "none", "row_group_size": 128, "store_schema": False} | options
    pq.write_table(table, FOLDER / "read_parquet" / name, **options)


for kind in ["read_arrow", "read_parquet"]:
    (FOLDER / kind).mkdir(exist_ok=True)
arrow("plain.arrow", SIZED)
arrow("lz4.feather", PLAIN, compression="lz4")
arrow("zstd.arrow", PLAIN, compression="zstd")
arrow("stream.arrows", SIZED, new=ipc.new_stream)
arrow("types.arrow", TYPES)
arrow("seconds.arrow", SECONDS)
parquet("plain.parquet", SIZED, store_schema=True)
for codec in ["snappy", "gzip", "zstd", "lz4"]:
    parquet(f"{codec}.parquet", PLAIN, compression=codec, write_page_checksum=codec == "zstd")
parquet("version_2.parquet", PLAIN, compression="snappy", data_page_version="2.0")
parquet("types.parquet", TYPES)
parquet("seconds.parquet", SECONDS, use_dictionary=False)
delta = {"t": "DELTA_BINARY_PACKED", "x": "BYTE_STREAM_SPLIT", "y": "DELTA_BINARY_PACKED", "p": "RLE"}
parquet("encodings.parquet", REQUIRED, use_dictionary=False, column_encoding=delta, data_page_version="2.0")

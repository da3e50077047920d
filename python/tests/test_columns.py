"""Columns in the memory of others: Arrow, Polars, pandas, DLPack."""

from __future__ import annotations

import gc
from typing import Any

import numpy as np
import pytest

import eecvs


def test_pyarrow_takes_columns_without_a_copy(recording: eecvs.Recording, events: Any) -> None:
    arrow = pytest.importorskip("pyarrow")
    columns = recording.columns()
    batch = arrow.record_batch(columns)
    assert batch.schema.names == ["t", "x", "y", "p"]
    assert [str(kind) for kind in batch.schema.types] == ["int64", "uint16", "uint16", "bool"]
    for name in "txy":
        assert batch.column(name).buffers()[1].address == getattr(columns, name).ctypes.data
    # The batch keeps the memory.
    del columns
    gc.collect()
    for name in "txyp":
        assert np.array_equal(batch.column(name).to_numpy(zero_copy_only=False), events[name])
    schema = arrow.schema(recording.columns())
    assert schema == batch.schema
    assert len(arrow.record_batch(eecvs.open(recording.path).columns()).slice(3, 5)) == 5


def test_capsules_that_nobody_takes_are_freed(recording: eecvs.Recording) -> None:
    columns = recording.columns()
    for _ in range(100):
        schema, array = columns.__arrow_c_array__()
        del schema, array
        columns.__arrow_c_schema__()
    gc.collect()


def test_polars_and_pandas(recording: eecvs.Recording, events: Any) -> None:
    polars = pytest.importorskip("polars")
    columns = recording.columns()
    frame = polars.DataFrame(columns)
    assert frame.shape == (len(events), 4)
    for name in "txyp":
        assert np.array_equal(frame[name].to_numpy(), events[name])
    pandas = pytest.importorskip("pandas")
    if hasattr(pandas.DataFrame, "from_arrow"):
        frame = pandas.DataFrame.from_arrow(columns)
        assert np.array_equal(frame["p"].to_numpy(), events["p"])


def test_dlpack(recording: eecvs.Recording, events: Any) -> None:
    columns = recording.columns()
    for name in "txy":
        array = getattr(columns, name)
        again = np.from_dlpack(array)
        assert again.ctypes.data == array.ctypes.data
        assert np.array_equal(again, events[name])


def test_columns_are_events(recording: eecvs.Recording, events: Any) -> None:
    columns = recording.columns()
    assert eecvs.encode(columns) == eecvs.encode(events, sensor=recording.sensor)
    assert np.array_equal(eecvs.voxel(columns, 3), eecvs.voxel(events, 3, sensor=recording.sensor))
    assert repr(columns) == f"Columns of {len(events)} events"

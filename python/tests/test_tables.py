"""Tables of pandas, Polars and pyarrow as events, by the packages themselves."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SENSOR, same

import eecvs

Columns = dict[str, Any]


def of_pandas(columns: Columns) -> Any:
    return pytest.importorskip("pandas").DataFrame(columns)


def of_pandas_arrow(columns: Columns) -> Any:
    pytest.importorskip("pyarrow")
    return of_pandas(columns).convert_dtypes(dtype_backend="pyarrow")


def of_pandas_nullable(columns: Columns) -> Any:
    return of_pandas(columns).convert_dtypes()


def of_polars(columns: Columns) -> Any:
    return pytest.importorskip("polars").DataFrame(columns)


def of_pyarrow(columns: Columns) -> Any:
    pyarrow = pytest.importorskip("pyarrow")
    table = pyarrow.table(columns)
    # Of two chunks, as most tables are.
    return pyarrow.concat_tables([table.slice(0, 7), table.slice(7)])


def of_pyarrow_batch(columns: Columns) -> Any:
    return pytest.importorskip("pyarrow").RecordBatch.from_pydict(columns)


MAKERS: list[Callable[[Columns], Any]] = [
    of_pandas,
    of_pandas_arrow,
    of_pandas_nullable,
    of_polars,
    of_pyarrow,
    of_pyarrow_batch,
]


@pytest.fixture(params=MAKERS, ids=lambda make: make.__name__[3:])
def make(request: pytest.FixtureRequest) -> Callable[[Columns], Any]:
    return request.param  # type: ignore[no-any-return]


def columns_of(events: Any, names: str = "t x y p") -> Columns:
    return {name: np.ascontiguousarray(events[of]) for name, of in zip(names.split(), "txyp")}


def test_a_table_is_taken_wherever_events_are(make: Any, events: Any, tmp_path: Path) -> None:
    table = make(columns_of(events))
    frames = eecvs.encode(table, sensor=SENSOR)
    assert frames == eecvs.encode(events, sensor=SENSOR)
    encoder = eecvs.Encoder(SENSOR)
    assert encoder.push(table) + encoder.finish() == frames
    eecvs.write(tmp_path / "a.raw", table, sensor=SENSOR)
    eecvs.write(tmp_path / "b.raw", iter([table]), sensor=SENSOR)
    assert same(eecvs.open(tmp_path / "a.raw").read(), events)
    assert same(eecvs.open(tmp_path / "b.raw").read(), events)
    voxels = eecvs.voxel(events, 3, sensor=SENSOR)
    assert np.array_equal(eecvs.voxel(table, 3, sensor=SENSOR), voxels)
    assert np.array_equal(eecvs.voxel([table, events], 3, sensor=SENSOR), np.stack([voxels, voxels]))
    assert np.array_equal(eecvs.counts(table, 3, sensor=SENSOR), eecvs.counts(events, 3, sensor=SENSOR))
    assert np.array_equal(eecvs.tore(table, sensor=SENSOR), eecvs.tore(events, sensor=SENSOR))
    assert eecvs.picture(table, sensor=SENSOR).png() == eecvs.picture(events, sensor=SENSOR).png()
    assert eecvs.compare(table, events, sensor=SENSOR).exact_fraction == 1


@pytest.mark.parametrize("names", ["t x y p", "timestamp x y polarity", "ts x y on", "time x y pol", "t_us x y p"])
def test_names_of_others(make: Any, events: Any, names: str) -> None:
    columns = columns_of(events, names)
    columns["more"] = np.zeros(len(events), np.float32)
    assert eecvs.encode(make(columns), sensor=SENSOR) == eecvs.encode(events, sensor=SENSOR)


def test_types_of_others(make: Any, events: Any) -> None:
    columns = columns_of(events)
    for kind in ("u8", "m8[us]"):
        columns["t"] = events["t"].astype(kind)
        assert eecvs.encode(make(columns), sensor=SENSOR) == eecvs.encode(events, sensor=SENSOR)
    columns["p"] = np.where(events["p"], 1, -1).astype(np.int8)
    columns["x"] = events["x"].astype(np.int64)
    assert eecvs.encode(make(columns), sensor=SENSOR) == eecvs.encode(events, sensor=SENSOR)


def test_wrong_tables_are_refused(make: Any, events: Any) -> None:
    columns = columns_of(events)
    for name, wrong, message in (
        ("t", events["t"] / 1e6, "^t is .*: whole numbers are needed, times in microseconds"),
        ("t", events["t"].astype("m8[ns]"), "^t is .*: whole numbers are needed, times in microseconds"),
        ("x", events["x"].astype("m8[us]"), "^x is .*: whole numbers are needed"),
        ("y", events["y"] + np.float32(0.5), "^y is .*: whole numbers are needed"),
        ("p", np.where(events["p"], "on", "off"), "^p is .*: whole numbers are needed"),
    ):
        with pytest.raises(TypeError, match=message):
            eecvs.encode(make({**columns, name: wrong}), sensor=SENSOR)
    with pytest.raises(ValueError, match="^events have the columns t, x, z, p: none is called y$"):
        eecvs.encode(make(columns_of(events, "t x z p")), sensor=SENSOR)
    with pytest.raises(ValueError, match="^events have the columns when, x, y, p: none is called t or ts or timestamp"):
        eecvs.voxel(make(columns_of(events, "when x y p")), 3, sensor=SENSOR)
    with pytest.raises(ValueError, match="sensor= is needed"):
        eecvs.encode(make(columns))
    with pytest.raises(eecvs.RefusedError, match="x is -1: it must be 0 to 2047"):
        eecvs.encode(make({**columns, "x": np.full(len(events), -1)}), sensor=SENSOR)


def test_missing_values_are_refused(make: Any) -> None:
    columns = {"t": [1, None, 3], "x": [0, 1, 2], "y": [0, 1, 2], "p": [True, False, True]}
    with pytest.raises(ValueError, match="^t has missing values: leave these rows out"):
        eecvs.encode(make(columns), sensor=SENSOR)
    columns = {"t": [1, 2, 3], "x": [0, 1, 2], "y": [0, 1, 2], "p": [True, None, True]}
    with pytest.raises(ValueError, match="^p has missing values: leave these rows out"):
        eecvs.voxel(make(columns), 3, sensor=SENSOR)


def test_the_example_of_the_page() -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "python.md"
    (block,) = re.findall(r"^```python\n(import pandas\n.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    pytest.importorskip("pandas")
    names: dict[str, Any] = {"eecvs": eecvs}
    exec(compile(block, str(page), "exec"), names)
    assert eecvs.decode(names["frames"])["p"].tolist() == [True, False]


def test_no_events(make: Any, events: Any) -> None:
    assert len(eecvs.decode(eecvs.encode(make(columns_of(events[:0])), sensor=SENSOR))) == 0


def test_a_stream_of_pyarrow_is_batches(events: Any) -> None:
    table = of_pyarrow(columns_of(events))
    assert eecvs.encode(table.to_reader(), sensor=SENSOR) == eecvs.encode(events, sensor=SENSOR)


def test_a_query_is_refused(events: Any) -> None:
    for use in (lambda query: eecvs.encode(query, sensor=SENSOR), lambda query: eecvs.voxel(query, 3, sensor=SENSOR)):
        with pytest.raises(TypeError, match=r"LazyFrame.*: give events\.collect\(\)"):
            use(of_polars(columns_of(events)).lazy())


def test_what_columns_give_comes_back(recording: eecvs.Recording, events: Any) -> None:
    polars, pyarrow = pytest.importorskip("polars"), pytest.importorskip("pyarrow")
    for table in (polars.DataFrame(recording.columns()), pyarrow.table(recording.columns())):
        assert eecvs.encode(table, sensor=SENSOR) == eecvs.encode(events, sensor=SENSOR)


def test_the_table_of_evlib(recording: eecvs.Recording, events: Any) -> None:
    evlib = pytest.importorskip("evlib")
    table = evlib.load_events(str(recording.path)).collect()
    assert eecvs.encode(table, sensor=SENSOR) == eecvs.encode(events, sensor=SENSOR)

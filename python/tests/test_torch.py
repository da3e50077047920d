"""Recordings in torch: tensors of columns, and the batches of a DataLoader."""

from __future__ import annotations

import multiprocessing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SENSOR

import eecvs
from eecvs.data import Windows

torch = pytest.importorskip("torch")


@pytest.fixture
def data(tmp_path: Path, events: Any) -> Windows:
    path = tmp_path / "a.eecvs"
    eecvs.write(path, events, sensor=SENSOR, window_us=5000)
    return Windows(path, 7000, partial(eecvs.voxel, bins=3))


@pytest.mark.parametrize("method", [None, "fork", "spawn"])
def test_batches_are_windows(data: Windows, method: Any) -> None:
    if method not in [None, *multiprocessing.get_all_start_methods()]:
        pytest.skip(f"there is no {method} here")
    # A fork after a part was read.
    wanted = np.stack([data[i] for i in range(len(data))])
    loader = torch.utils.data.DataLoader(data, batch_size=4, num_workers=2 if method else 0, multiprocessing_context=method)
    batches = list(loader)
    assert [len(batch) for batch in batches[:-1]] == [4] * (len(batches) - 1)
    assert torch.cat(batches).dtype == torch.float32
    assert np.array_equal(torch.cat(batches).numpy(), wanted)


def test_a_shuffled_epoch_has_every_window_once(data: Windows) -> None:
    loader = torch.utils.data.DataLoader(data, batch_size=3, shuffle=True, num_workers=2)
    sums = sorted(float(window.abs().sum()) for batch in loader for window in batch)
    assert np.allclose(sums, sorted(float(np.abs(data[i]).sum()) for i in range(len(data))), rtol=1e-5)


def test_columns_become_tensors_without_a_copy(recording: eecvs.Recording, events: Any) -> None:
    columns = recording.columns()
    t, x, p = torch.from_numpy(columns.t), torch.from_numpy(columns.x.view(np.int16)), torch.from_numpy(columns.p)
    assert t.data_ptr() == columns.t.ctypes.data and x.data_ptr() == columns.x.ctypes.data
    assert (t.numpy() == events["t"]).all() and (x.numpy() == events["x"]).all() and (p.numpy() == events["p"]).all()


def test_a_tensor_is_filled(events: Any) -> None:
    out = torch.empty((3, SENSOR[1], SENSOR[0]))
    eecvs.voxel(events, 3, sensor=SENSOR, out=out.numpy())
    assert np.array_equal(out.numpy(), eecvs.voxel(events, 3, sensor=SENSOR))

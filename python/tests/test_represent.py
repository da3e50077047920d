"""Arrays for networks against their formulas in NumPy, and against those of others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import SENSOR, random_events

import eecvs

WIDTH, HEIGHT = SENSOR


def twin_voxel(events: Any, bins: int, t0: int, t1: int, weights: str, split: bool) -> Any:
    out = np.zeros(((2 if split else 1) * bins, HEIGHT, WIDTH))
    t, x, y, p = (events[name].astype(np.int64) for name in "txyp")
    first = np.where((p == 0) & split, bins, 0)
    value = np.where((p == 1) | split, 1.0, -1.0)
    if weights == "nearest":
        bin_ = np.minimum((t - t0) * bins // (t1 - t0), bins - 1)
        np.add.at(out, (first + bin_, y, x), value)
        return out
    tau = (bins - 1) * (t - t0) / (t1 - t0)
    for bin_ in range(bins):
        np.add.at(out, (first + bin_, y, x), value * np.maximum(0, 1 - np.abs(bin_ - tau)))
    return out


@pytest.mark.parametrize("weights", ["nearest", "bilinear"])
@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize("bins", [1, 2, 7, 64])
def test_voxel(events: Any, weights: Any, split: bool, bins: int) -> None:
    polarity: Any = "split" if split else "signed"
    first, last = int(events["t"][0]), int(events["t"][-1])
    for times in [{}, {"t0_us": first - 3, "t1_us": last + 99}]:
        found = eecvs.voxel(events, bins, sensor=SENSOR, weights=weights, polarity=polarity, **times)
        t0, t1 = times.get("t0_us", first), times.get("t1_us", last)
        wanted = twin_voxel(events, bins, t0, t1, weights, split)
        assert found.dtype == np.float32 and found.shape == wanted.shape
        assert np.allclose(found, wanted, atol=1e-4)
        half = eecvs.voxel(events, bins, sensor=SENSOR, weights=weights, polarity=polarity, dtype="float16", **times)
        assert half.dtype == np.float16 and np.array_equal(half, found.astype(np.float16))


@pytest.mark.parametrize("bins", [1, 10])
def test_counts(events: Any, bins: int) -> None:
    wanted = twin_voxel(events, bins, int(events["t"][0]), int(events["t"][-1]), "nearest", True)
    found = eecvs.counts(events, bins, sensor=SENSOR)
    assert found.dtype == np.uint8 and np.array_equal(found, wanted)
    assert np.array_equal(eecvs.counts(events, bins, sensor=SENSOR, most=2), np.minimum(wanted, 2))
    assert np.array_equal(eecvs.counts(events, bins, sensor=SENSOR, dtype="float32"), wanted)
    crowd = np.repeat(events[:1], 700)
    assert eecvs.counts(crowd, sensor=SENSOR).max() == 255


def test_time_surface(events: Any) -> None:
    end = int(events["t"][-1])
    wanted = np.zeros((2, HEIGHT, WIDTH))
    for event in events:
        wanted[0 if event["p"] else 1, event["y"], event["x"]] = np.exp(-(end - event["t"]) / 5e3)
    assert np.allclose(eecvs.time_surface(events, 5e3, sensor=SENSOR), wanted, atol=1e-6)
    later = eecvs.time_surface(events, 5e3, sensor=SENSOR, t_us=end + 1000)
    assert np.allclose(later, wanted * np.exp(-0.2), atol=1e-6)
    with pytest.raises(eecvs.RefusedError, match="after the time"):
        eecvs.time_surface(events, 5e3, sensor=SENSOR, t_us=end - 1)
    with pytest.raises(eecvs.RefusedError, match="above 0"):
        eecvs.time_surface(events, 0, sensor=SENSOR)


@pytest.mark.parametrize("k", [1, 3])
def test_tore(events: Any, k: int) -> None:
    end = int(events["t"][-1])
    ages = np.full((2, k, HEIGHT, WIDTH), 5e6)
    for event in events:
        queue = ages[0 if event["p"] else 1, :, event["y"], event["x"]]
        queue[1:] = queue[:-1].copy()
        queue[0] = min(5e6, end - event["t"])
    wanted = np.maximum(0, np.log(ages + 1) - np.log(151)).reshape(2 * k, HEIGHT, WIDTH)
    assert np.allclose(eecvs.tore(events, k, sensor=SENSOR), wanted, atol=1e-5)


def test_batches_and_out(events: Any) -> None:
    windows = [events[:5000], events[5000:5001], events[5001:], events[:0]]
    for make in [
        lambda e, **o: eecvs.voxel(e, 3, sensor=SENSOR, t0_us=0, t1_us=10**8, **o),
        lambda e, **o: eecvs.counts(e, 2, sensor=SENSOR, **o),
        lambda e, **o: eecvs.time_surface(e, 1e4, sensor=SENSOR, **o),
        lambda e, **o: eecvs.tore(e, sensor=SENSOR, **o),
    ]:
        one = [make(window) for window in windows]
        batch = make(windows)
        assert batch.shape == (4, *one[0].shape)
        assert all(np.array_equal(a, b) for a, b in zip(batch, one))
        out = np.full(batch.shape, 7, batch.dtype)
        assert make(tuple(windows), out=out) is out
        assert np.array_equal(out, batch)
        single = np.full(one[0].shape, 7, batch.dtype)
        assert make(windows[0], out=single) is single and np.array_equal(single, one[0])
    assert eecvs.counts([], 2, sensor=SENSOR).shape[0] == 0


def test_wrong_outs_are_refused(events: Any) -> None:
    for out in [
        np.zeros((3, HEIGHT, WIDTH + 1), np.float32), np.zeros((3, WIDTH, HEIGHT), np.float32).transpose(0, 2, 1),
        np.zeros((HEIGHT, WIDTH), np.float32),
    ]:  # fmt: skip
        with pytest.raises(ValueError, match="out"):
            eecvs.voxel(events, 3, sensor=SENSOR, out=out)
    with pytest.raises((TypeError, ValueError)):
        eecvs.voxel(events, 3, sensor=SENSOR, out=np.zeros((3, HEIGHT, WIDTH)))
    fixed = np.zeros((3, HEIGHT, WIDTH), np.float32)
    fixed.flags.writeable = False
    with pytest.raises(ValueError, match="out"):
        eecvs.voxel(events, 3, sensor=SENSOR, out=fixed)
    with pytest.raises(TypeError):
        eecvs.voxel(events, 3, sensor=SENSOR, out=[1, 2])  # type: ignore[call-overload]
    with pytest.raises(eecvs.RefusedError, match="uint8"):
        eecvs.voxel(events, 3, sensor=SENSOR, dtype="uint8")  # type: ignore[call-overload]


def test_what_is_outside_is_refused(events: Any) -> None:
    first, last = int(events["t"][0]), int(events["t"][-1])
    for times, word in [
        ({"t0_us": first + 100}, "outside the times"),
        ({"t1_us": last}, "outside the times"),
        ({"t0_us": 5, "t1_us": 5}, "1 us or more"),
    ]:
        with pytest.raises(eecvs.RefusedError, match=word):
            eecvs.voxel(events, 3, sensor=SENSOR, **times)
    with pytest.raises(eecvs.RefusedError, match="outside the sensor"):
        eecvs.counts(events, 3, sensor=(10, 10))
    with pytest.raises(ValueError, match="sensor="):
        eecvs.counts(events, 3)
    with pytest.raises(ValueError, match="bilinear"):
        eecvs.voxel(events, 3, sensor=SENSOR, weights="cubic")  # type: ignore[call-overload]
    for wrong in [0, 5000]:
        with pytest.raises(ValueError, match="4096"):
            eecvs.voxel(events, wrong, sensor=SENSOR)


def test_tonic_s_grid_is_ours_of_one_bin_more(tonic: Any, events: Any) -> None:
    """tonic scales times by B, from the first event's to the last one's, and lets what falls into bin B go."""
    theirs = np.zeros(len(events), [("x", "<i2"), ("y", "<i2"), ("t", "<i8"), ("p", "<i2")])
    for name in "xytp":
        theirs[name] = events[name]
    wanted = tonic.functional.to_voxel_grid_numpy(theirs.copy(), (*SENSOR, 2), 5)[:, 0]
    found = eecvs.voxel(events, 6, sensor=SENSOR)[:5]
    assert np.allclose(found, wanted, atol=1e-4)


def test_rvt_s_histogram_has_off_first() -> None:
    """The formula of RVT's StackedHistogram, in float64: it divides by the time from the first to the last event."""
    events = random_events(5000, seed=3)
    bins = 10
    t = events["t"].astype(np.float64)
    norm = (t - t[0]) / max(t[-1] - t[0], 1) * bins
    index = np.minimum(np.floor(norm), bins - 1).astype(int)
    wanted = np.zeros((2, bins, HEIGHT, WIDTH))
    np.add.at(wanted, (events["p"].astype(int), index, events["y"], events["x"]), 1)
    found = eecvs.counts(events, bins, sensor=SENSOR)
    assert np.array_equal(np.concatenate([found[bins:], found[:bins]]), wanted.reshape(-1, HEIGHT, WIDTH))

"""Scenes of the emulator, distortion and pictures."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SENSOR, random_events, same

import eecvs

SMALL: dict[str, Any] = {"sensor": (32, 24), "duration_us": 100_000}


def test_every_scene_is_a_recording() -> None:
    for name, about in eecvs.SCENES.items():
        assert about
        scene = eecvs.emulate(name, **SMALL)
        assert (scene.sensor, scene.format, scene.path) == ((32, 24), "scene", None)
        events = scene.read()
        assert len(events) and events["t"].max() < 100_000
        assert same(events, scene.read())
        assert same(events, np.concatenate(list(scene.by_time(10_000, origin_us=0))))


def test_a_scene_is_taken_where_events_are(tmp_path: Path) -> None:
    scene = eecvs.emulate("motorcycle", seed=3, start_us=5, **SMALL)
    events = scene.read()
    eecvs.write(tmp_path / "scene.raw", scene)
    assert same(eecvs.open(tmp_path / "scene.raw").read(), events)
    assert eecvs.encode(scene) == eecvs.encode(events, sensor=(32, 24))
    assert scene.info.events == len(events)
    assert scene.info.xxh128_sum_events == eecvs.open(tmp_path / "scene.raw").info.xxh128_sum_events
    assert same(scene.time[20_000:30_000], events[(events["t"] >= 20_000) & (events["t"] < 30_000)])
    assert same(pickle.loads(pickle.dumps(scene)).read(), events)
    assert not same(eecvs.emulate("motorcycle", seed=4, start_us=5, **SMALL).read(), events)


def test_causes_are_those_of_the_events() -> None:
    scene = eecvs.emulate("indoor-dark-blur", **SMALL)
    causes = scene.causes()
    assert causes.dtype == np.uint8 and len(causes) == len(scene.read())
    assert causes.max() < len(eecvs.CAUSES)
    noise = ["shot-noise", "leak", "jitter", "defects"]
    quiet = eecvs.emulate("indoor-dark-blur", without=noise, **SMALL)
    assert not quiet.causes().any()
    with pytest.raises(eecvs.UnsupportedError, match="model=2"):
        eecvs.emulate("motorcycle", model=1, **SMALL).causes()


def test_truth_is_that_of_the_scene(tmp_path: Path) -> None:
    scene = eecvs.emulate("motorcycle", start_us=5, **SMALL)
    truth = scene.truth(60_005)
    assert truth.objects == ("background", "box", "lamp")
    assert (truth.object.shape, truth.object.dtype) == ((24, 32), np.uint8)
    assert (truth.flow.shape, truth.flow.dtype) == ((24, 32, 2), np.float32)
    assert truth.depth is not None and truth.depth.dtype == np.float32
    assert set(np.unique(truth.object)) == {0, 1, 2}
    # The box crosses 1.7 of the width and 0.1 of the height in a second, the lamp stays.
    assert np.allclose(truth.flow[truth.object == 1], (1.7 * 32, 0.1 * 24))
    assert not truth.flow[truth.object == 2].any()
    # Nearer rows of the background pass more quickly.
    background = truth.object == 0
    assert (np.isnan(truth.depth) == ~background).all()
    pace = (truth.flow[..., 0] * truth.depth)[background]
    assert np.allclose(pace, pace[0]) and pace[0] < 0
    assert eecvs.emulate("indoor-dark-blur", **SMALL).truth(0).depth is None
    # Model and seed do not change it.
    other = eecvs.emulate("motorcycle", model=1, seed=9, **SMALL).truth(60_000)
    assert np.array_equal(other.object, truth.object) and np.array_equal(other.flow, truth.flow)
    with pytest.raises(eecvs.RefusedError, match="before the scene's beginning"):
        scene.truth(4)
    with pytest.raises(OverflowError):
        scene.truth(-1)
    eecvs.write(tmp_path / "scene.raw", scene)
    with pytest.raises(eecvs.UnsupportedError, match="only scenes"):
        eecvs.open(tmp_path / "scene.raw").truth(5)


def test_parameters_of_the_pixel() -> None:
    def count(**pixel: float) -> int:
        return len(eecvs.emulate("motorcycle", pixel=pixel, **SMALL).read())

    assert count(threshold_on=0.5, threshold_off=0.5) < count(threshold_on=0.15, threshold_off=0.15)
    with pytest.raises(eecvs.RefusedError, match="there is no parameter gain"):
        count(gain=1)
    with pytest.raises(eecvs.RefusedError):
        count(threshold_on=float("nan"))
    for wrong in (
        {"scene": "mars"},
        {"model": 3},
        {"without": ["rain"]},
        {"without": ["leak"], "model": 1},
        {"pixel": {"threshold_on": 0.2}, "model": 1},
        {"sensor": (0, 4)},
        {"dtype": "none"},
    ):
        with pytest.raises(ValueError):
            eecvs.emulate(**{"scene": "motorcycle", **wrong})  # type: ignore[arg-type]


def test_comparison() -> None:
    events = random_events(4000)
    alike = eecvs.compare(events, events, sensor=SENSOR)
    assert (alike.exact_fraction, alike.missing_events, alike.emd_pixel_us) == (1, 0, 0)
    fewer = eecvs.compare(events, events[:3000], sensor=SENSOR)
    assert (fewer.missing_events, fewer.surplus_events, fewer.events_b) == (1000, 0, 3000)
    later = events.copy()
    later["t"] += 77
    ahead = eecvs.compare(events, later, sensor=SENSOR)
    assert ahead.clock_offset_us == 77 and not ahead.aligned and ahead.emd_pixel_us > 0
    for a, b in ((events, later), (later, events)):
        aligned = eecvs.compare(a, b, sensor=SENSOR, align=True)
        assert aligned.aligned and aligned.exact_fraction == 1
    # Times that are sent in steps of 10 us are off by at most 5.
    frames = eecvs.encode(events, sensor=SENSOR, time_tolerance_us=5)
    assert 0 < eecvs.compare(events, eecvs.decode(frames), sensor=SENSOR).emd_pixel_us <= 5


def test_what_cannot_be_compared() -> None:
    events = random_events(100)
    with pytest.raises(ValueError, match="sensor= is needed"):
        eecvs.compare(events, events)
    with pytest.raises(eecvs.RefusedError, match="no events"):
        eecvs.compare(events[:0], events, sensor=SENSOR)
    with pytest.raises(ValueError, match="window_us"):
        eecvs.compare(events, events, sensor=SENSOR, window_us=0)
    with pytest.raises(TypeError, match="a recording, a structured array"):
        eecvs.compare(iter([events]), events, sensor=SENSOR)  # type: ignore[arg-type]


def test_pictures(tmp_path: Path) -> None:
    events = random_events(500)
    picture = eecvs.picture(events, sensor=SENSOR)
    assert picture.size[0] >= 480
    assert picture.png()[:8] == b"\x89PNG\r\n\x1a\n" and picture._repr_png_() == picture.png()
    assert eecvs.picture([events[:200], events[200:]], sensor=SENSOR).png() == picture.png()
    assert eecvs.picture(events, sensor=SENSOR, upscale=1).size == SENSOR
    picture.save(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes() == picture.png()
    with pytest.raises(eecvs.RefusedError):
        picture.save(tmp_path / "a.png")
    picture.save(tmp_path / "a.png", overwrite=True)
    with pytest.raises(eecvs.RefusedError, match="there is no folder"):
        picture.save(tmp_path / "none" / "a.png")
    with pytest.raises(eecvs.RefusedError, match="outside the sensor"):
        eecvs.picture(events, sensor=(8, 8))
    for wrong in ({"clip": 0}, {"upscale": 0}, {"upscale": 65}):
        with pytest.raises(ValueError):
            eecvs.picture(events, sensor=SENSOR, **wrong)  # type: ignore[arg-type]

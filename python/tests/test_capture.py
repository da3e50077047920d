"""Live devices, simulated: no hardware is needed."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import random_events, same

import eecvs

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="devices are captured on Linux alone")

SENSOR = (346, 260)


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Any]:
    """A simulated camera and the events that it plays."""
    path = tmp_path_factory.mktemp("capture") / "davis.raw"
    events = random_events(50_000, size=SENSOR)
    eecvs.write(path, events, sensor=SENSOR)
    return f"sim:davis346:{path}", events


def test_a_camera_gives_the_events_that_it_plays(played: tuple[str, Any]) -> None:
    device, events = played
    with eecvs.capture(device, rate="max") as camera:
        assert (camera.model, camera.sensor) == ("davis346", SENSOR)
        assert camera.report is None
        batches = list(camera)
    found = np.concatenate(batches)
    # Events of equal time come in the order of rows; the camera's clock starts at its own time.
    found["t"] += events["t"][0] - found["t"][0]
    assert same(np.sort(found), np.sort(events))
    assert camera.losses == {}
    report: dict[str, Any] = camera.report or {}
    assert (report["events"], report["width"], report["losses"]) == (len(events), 346, {})
    assert list(camera) == []


def test_a_capture_is_encoded_as_it_comes(played: tuple[str, Any], tmp_path: Path) -> None:
    device, events = played
    encoder = eecvs.Encoder(SENSOR)
    frames = b"".join(encoder.push(batch) for batch in eecvs.capture(device, rate="max", dtype="dv"))
    frames += encoder.finish()
    assert len(eecvs.decode(frames)) == len(events)
    eecvs.write(tmp_path / "live.aedat4", eecvs.capture(device, rate="max"), sensor=SENSOR)
    assert len(eecvs.open(tmp_path / "live.aedat4").read()) == len(events)


def test_limits_and_stopping(played: tuple[str, Any]) -> None:
    device, events = played
    slow: dict[str, Any] = {"rate": "100000"}
    few = sum(map(len, eecvs.capture(device, max_events=1000, **slow)))
    assert 1000 <= few < len(events)
    start = time.monotonic()
    short = sum(map(len, eecvs.capture(device, duration_s=0.1, **slow)))
    assert short < len(events) and time.monotonic() - start < 5
    with eecvs.capture(device, rate="10") as camera:
        threading.Timer(0.1, camera.stop).start()
        assert sum(map(len, camera)) < 100
    camera = eecvs.capture(device, rate="10")
    camera.close()
    camera.close()
    assert list(camera) == []
    del camera
    # A capture that is let go of stops by itself.
    eecvs.capture(device, rate="10")


def test_a_slow_program_loses_and_learns_it(tmp_path: Path) -> None:
    path = tmp_path / "many.raw"
    eecvs.write(path, random_events(400_000, size=SENSOR), sensor=SENSOR)
    with eecvs.capture(f"sim:davis346:{path}", rate="100x", queue_mib=1) as camera:
        time.sleep(0.5)
        with pytest.warns(eecvs.LossWarning, match="no room"):
            found = sum(map(len, camera))
    assert found < 400_000
    assert camera.losses and camera.report and camera.report["overrun_bytes"] > 0


def test_what_cannot_be_captured(played: tuple[str, Any]) -> None:
    device, _ = played
    for wrong in (
        {"rate": "never"},
        {"duration_s": -1},
        {"duration_s": float("nan")},
        {"queue_mib": 0},
        {"dtype": "none"},
        {"device": "sim:davis346"},
        {"device": "sim:none:file"},
    ):
        with pytest.raises(ValueError):
            eecvs.capture(**{"device": device, **wrong})  # type: ignore[arg-type]
    with pytest.raises(eecvs.EecvsError, match="none.raw"):
        eecvs.capture("sim:davis346:none.raw")
    with pytest.raises(eecvs.EecvsError):
        eecvs.capture("no such camera")


def test_another_process_has_no_part_in_it(played: tuple[str, Any]) -> None:
    camera = eecvs.capture(played[0], rate="10")
    child = os.fork()
    if child == 0:
        try:
            next(camera)
        except eecvs.RefusedError:
            os._exit(7)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    camera.close()


def test_an_interrupt_ends_the_wait(played: tuple[str, Any]) -> None:
    code = """
import eecvs, os, signal, sys, threading
# Where the tests run in the background, it is ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
camera = eecvs.capture(sys.argv[1], rate="1")
next(camera, None)
threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
try:
    list(camera)
except KeyboardInterrupt:
    sys.exit(9)
"""
    ended = subprocess.run([sys.executable, "-c", code, played[0]], timeout=60)
    assert ended.returncode == 9

"""Clips: windows of scenes with masks of what moves by itself, and windows of real recordings without masks.

A window lasts `WINDOW_US`. The mask of a window is that of its middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import eecvs

WINDOW_US = 32_768
#: Objects move by themselves where they and the background beside them differ by more than this, in pixels per second.
SPEED_MIN = 5.0
#: What is taken of a recording, at the most, and at least one window: windows, events, and pixels of all windows.
WINDOWS_MAX = 12
EVENTS_MAX = 150_000
PIXELS_MAX = 12 * 346 * 260

#: The scenes of which the network learns, and those that it never sees: chosen before any result was there. Both have
#: scenes without a moving object.
TRAIN = ("indoor-dark-hdr", "indoor-flying", "outdoor-low-brightness", "indoor-hdr-blur", "outdoor-dark-blur")
TEST = ("motorcycle", "outdoor-well-lit-blur", "outdoor-dark", "indoor-dark-blur")
RECORDINGS = (
    "davis240_boxes_moderate/IMU_translBoxes.aedat",
    "davis346_building_dense/davis.aedat4",
    "davis346_static_sparse/davis346.aedat4",
    "dvs128_standup/cam255_alex_standing_up2.aedat",
    "dvs128_walking_moderate/alex_walking_for_10secs.aedat",
    "dvs128_walking_sparse/neal_walking.aedat",
    "dvxl_person_moderate/data_sample.aedat4",
    "gen31_vga_rosbag_moderate/test_events_1.bag",
    "gen3_vga_dense_evt2/evt2.raw",
)


@dataclass(frozen=True)
class Clip:
    """Consecutive windows of one source."""

    name: str
    sensor: tuple[int, int]
    #: Start of the first window.
    start_us: int
    #: Number of windows.
    count: int
    #: The events of these windows, in the order of time.
    events: Any
    #: What moves by itself: (count, H, W) of bool; None where nobody knows.
    masks: Any = None

    def times(self, index: int) -> tuple[int, int]:
        """Returns the times of a window in microseconds, half-open."""
        start = self.start_us + index * WINDOW_US
        return start, start + WINDOW_US

    def cut(self, events: Any) -> list[Any]:
        """Returns the events of each window: of this clip's, or of what came back of them."""
        edges = self.start_us + WINDOW_US * np.arange(self.count + 1)
        edges = np.searchsorted(events["t"], edges)
        return [events[first:last] for first, last in zip(edges, edges[1:])]


def moving(truth: eecvs.Truth) -> Any:
    """Returns the pixels of the objects that move by themselves: (H, W) of bool.

    The background has one flow in each row, so that the background's flow behind an object is known from a pixel beside it,
    or from the nearest row that has one. An object moves by itself if most of its pixels move otherwise than that. A lamp
    does not: it is fixed in the picture, whatever the camera does.
    """
    background = truth.object == 0
    mask = np.zeros(background.shape, bool)
    rows = np.flatnonzero(background.any(1))
    if not len(rows):
        return mask
    nearest = rows[np.abs(np.arange(len(mask))[:, None] - rows).argmin(1)]
    of_row = truth.flow[nearest, background[nearest].argmax(1)]
    differs = np.linalg.norm(truth.flow - of_row[:, None], axis=2) > SPEED_MIN
    for number, what in enumerate(truth.objects):
        pixels = truth.object == number
        if what == "box" and pixels.any() and differs[pixels].mean() > 0.5:
            mask |= pixels
    return mask


def of_scene(name: str, seed: int, sensor: tuple[int, int], count: int) -> Clip:
    """Emulates `count` windows of a scene, with the pixel's noise and defects."""
    scene = eecvs.emulate(name, seed=seed, sensor=sensor, duration_us=count * WINDOW_US, model=2)
    clip = Clip(name, sensor, 0, count, scene.read())
    masks = np.stack([moving(scene.truth(clip.times(index)[0] + WINDOW_US // 2)) for index in range(count)])
    return Clip(name, sensor, 0, count, clip.events, masks)


def of_recording(path: Path, windows_max: int = WINDOWS_MAX) -> Clip:
    """Reads the consecutive windows with the most events: as many as the limits allow."""
    recording = eecvs.open(path)
    events = recording.read()
    events = events[np.argsort(events["t"], kind="stable")]
    first_us = int(events["t"][0])
    counts = np.bincount((events["t"] - first_us) // WINDOW_US)
    pixels = recording.sensor.width * recording.sensor.height
    for count in range(max(1, min(windows_max, len(counts), PIXELS_MAX // pixels)), 0, -1):
        sums = np.convolve(counts, np.ones(count, int), "valid")
        if sums.max() <= EVENTS_MAX or count == 1:
            break
    start_us = first_us + WINDOW_US * int(sums.argmax())
    clip = Clip(path.parent.name, recording.sensor, start_us, count, events)
    inside = (events["t"] >= start_us) & (events["t"] < clip.times(count)[0])
    return Clip(clip.name, clip.sensor, start_us, count, events[inside])


def thresholds_of(found: Sequence[Clip]) -> tuple[float, float]:
    """Returns the 25th and the 75th percentile of the windows' densities, in events per pixel per second: as the paper
    calibrates them."""
    densities = []
    for clip in found:
        pixels = clip.sensor[0] * clip.sensor[1]
        densities += [len(events) / (pixels * WINDOW_US * 1e-6) for events in clip.cut(clip.events)]
    low, high = np.percentile(densities, [25, 75])
    return float(low), float(high)

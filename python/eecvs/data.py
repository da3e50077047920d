"""Recordings as data sets of windows, for torch's DataLoader and anything else that takes a sequence.

Nothing here needs torch: a DataLoader takes any object with a length and items, and makes tensors of arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from operator import index as index_of
from typing import Any, Union

import numpy as np
import numpy.typing as npt

from ._eecvs import Recording, _whole, open
from ._types import Sensor

__all__ = ["Windows"]

# Times fit into int64.
_TIME_MAX = 2**63 - 1


class Windows:
    """The windows of a recording as a sequence of arrays: a map-style data set.

    Window ``i`` has the events with ``i us <= t - start_us < (i + 1) us``. Each item is read by itself, by any thread or
    process: from ``.eecvs`` files, and others with an index, without what is before it. Of an ``.eecvs`` file that was written
    with ``window_us=us`` and the first event's time as ``origin_us``, one window of the codec is decoded for each item. It can
    be pickled.

    Args:
        path: The recording.
        us: Duration of a window in microseconds, at least 1.
        make: Called as ``make(events, sensor=..., t0_us=..., t1_us=...)``, with a structured array and the window's times;
            what it returns is the item. ``functools.partial(eecvs.voxel, bins=5)`` is one. By default the item is the
            array of events.
        start_us, end_us: Times of the first window's start, and before which windows start; by default those of the first
            event and behind the last one, for which the recording is read once.
        **options: Those of ``eecvs.open``.

    Raises:
        TypeError, ValueError: A duration below 1, times that are no whole numbers, or an end before the start.
        EecvsError: The recording cannot be opened.
    """

    def __init__(
        self,
        path: Union[str, PathLike[str]],
        us: int,
        make: Union[Callable[..., Any], None] = None,
        *,
        start_us: Union[int, None] = None,
        end_us: Union[int, None] = None,
        **options: Any,
    ) -> None:
        us = _whole(us, "us", 1, _TIME_MAX)
        self.recording: Recording = open(path, **options)
        self.us = us
        self.make = make
        info = None
        if start_us is None or end_us is None:
            info = self.recording.info
            start_us = (info.t_first_us or 0) if start_us is None else start_us
            end_us = (-1 if info.t_last_us is None else info.t_last_us) + 1 if end_us is None else end_us
        start_us, end_us = _whole(start_us, "start_us", 0, _TIME_MAX), _whole(end_us, "end_us", 0, _TIME_MAX)
        if end_us < start_us and (info is None or info.events):
            raise ValueError(f"end_us is {end_us}: it must be {start_us} or more, as start_us is")
        self.start_us = start_us
        self.end_us = max(start_us, end_us)

    @property
    def sensor(self) -> Sensor:
        """Size of the sensor in pixels."""
        return self.recording.sensor

    def times(self, index: int) -> tuple[int, int]:
        """Returns the times of a window in microseconds, half-open."""
        index, count = index_of(index), len(self)
        if not -count <= index < count:
            raise IndexError(f"window {index} of {count}")
        start = self.start_us + index % count * self.us
        return start, start + self.us

    def events(self, index: int) -> npt.NDArray[np.void]:
        """Returns the events of a window: a structured array."""
        start, end = self.times(index)
        return self.recording.time[start:end]

    def __len__(self) -> int:
        return -((self.start_us - self.end_us) // self.us)

    def __getitem__(self, index: int) -> Any:
        start, end = self.times(index)
        events = self.recording.time[start:end]
        if self.make is None:
            return events
        return self.make(events, sensor=self.sensor, t0_us=start, t1_us=end)

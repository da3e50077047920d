"""A program for the checkers of types: it is not run."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

import eecvs


class Frame:
    """A table, as pandas and Polars have them."""

    columns = ["t", "x", "y", "p"]

    def __getitem__(self, name: str) -> Any:
        return np.zeros(0, np.int64)


def use(path: str) -> float:
    with eecvs.open(path, dtype="eecvs", damaged="keep") as recording:
        width, height = recording.sensor
        info: eecvs.Info = recording.info
        events: npt.NDArray[Any] = recording.read()
        part = recording.time[5:10]
        rest = recording.time[5:]
        columns = recording.columns()
        times: npt.NDArray[np.int64] = columns.t
        slices = recording.by_time(1000, origin_us=0)
        for window in slices:
            span = slices.times
            if span is not None:
                eecvs.counts(window, 4, sensor=(width, height), t0_us=span[0], t1_us=span[1])
        out = np.zeros((2, 5, height, width), np.float32)
        same: npt.NDArray[np.float32] = eecvs.voxel([events, part], 5, sensor=recording.sensor, out=out)
    frames: bytes = eecvs.encode(events, sensor=(width, height), coder="dense", m=8)
    encoder = eecvs.Encoder((width, height), window_us=1000)
    frames += encoder.push(rest) + encoder.push(Frame()) + encoder.finish()
    eecvs.tore([Frame(), events], sensor=(width, height))
    decoder = eecvs.Decoder(events="exact")
    volumes = [window.coefficients() for window in decoder.push(frames) + decoder.finish()]
    written: eecvs.Written = eecvs.write("a.eecvs", recording, coder="quick")
    try:
        eecvs.write("b.raw", (batch for batch in recording), sensor=(width, height))
    except eecvs.DamagedError as error:
        print(error.file, error.offset)
    return info.duration_s + len(volumes) + written.events_out + float(times[0]) + float(same[0, 0, 0, 0])

"""The volumes of `eecvs decode` against numpy.

Usage: reference_volumes.py [EVENTS.npz VOLUMES.npz BINS HOW POLARITY NORMALISE]...

EVENTS.npz has t, x, y, p; VOLUMES.npz is what `decode --volume VOLUMES.npz --all-windows --bins BINS --voxel HOW
--polarity POLARITY --normalise NORMALISE` wrote for lossless frames of the same events. Prints one JSON object for each
six arguments: the number of windows, of values that are not 0, of values that differ, and the largest difference. Exits
with 77 where numpy is missing.
"""

import json
import sys

try:
    import numpy as np
except ImportError as missing:
    print(missing, file=sys.stderr)
    sys.exit(77)


def volume(t, x, y, p, duration_us, bins, how, polarity, shape):
    """One window's volume; t counts from the window's start."""
    sums = np.zeros(shape, np.int64)
    sign = np.where(p == 1, 1, 1 if polarity == "split" else -1)
    first = np.where(p == 1, 0, bins if polarity == "split" else 0)
    if how == "nearest":
        np.add.at(sums, (first + t * bins // duration_us, y, x), sign)
        return sums.astype(np.float32)
    # max(0, 1 - |b - tau|) in units of 1 / T.
    before, rest = np.divmod(t * (bins - 1), duration_us)
    np.add.at(sums, (first + before, y, x), sign * (duration_us - rest))
    inside = rest > 0
    np.add.at(sums, ((first + before + 1)[inside], y[inside], x[inside]), (sign * rest)[inside])
    return (sums.astype(np.float64) / duration_us).astype(np.float32)


def normalised(values):
    """What is not 0 with mean 0 and deviation 1, or with the mean taken off where all are the same."""
    mask = values != 0
    found = values[mask].astype(np.float64)
    if found.size == 0:
        return values
    mean, deviation = found.mean(), found.std()
    scaled = found - mean
    if found.min() != found.max():
        scaled = scaled / deviation
    result = values.copy()
    result[mask] = scaled.astype(np.float32)
    return result


def main(arguments):
    for at in range(0, len(arguments), 6):
        events, volumes, bins, how, polarity, normalise = arguments[at : at + 6]
        events, volumes, bins = np.load(events), np.load(volumes), int(bins)
        t, x, y, p = (events[name].astype(np.int64) for name in "txyp")
        found = volumes["volume"]
        assert found.ndim == 4 and found.dtype == np.float32, (found.shape, found.dtype)
        seen = nonzero = different = 0
        largest = 0.0
        for values, t0_us, duration_us in zip(found, volumes["t0_us"], volumes["duration_us"]):
            inside = (t >= t0_us) & (t < t0_us + duration_us)
            seen += np.count_nonzero(inside)
            window = (t[inside] - t0_us, x[inside], y[inside], p[inside])
            wanted = volume(*window, duration_us, bins, how, polarity, values.shape)
            if normalise == "mean-std":
                wanted = normalised(wanted)
            nonzero += np.count_nonzero(wanted)
            different += np.count_nonzero(wanted != values)
            largest = max(largest, float(np.abs(wanted - values).max()))
        row = {"windows": len(found), "events": int(seen), "nonzero": int(nonzero)}
        print(json.dumps({**row, "different": int(different), "largest": largest}))


main(sys.argv[1:])

#!/usr/bin/env python3
"""The metrics of `eecvs compare` by numpy, scipy and scikit-image.

    pip install numpy scipy scikit-image
    python3 tests/reference_metrics.py
    python3 tests/reference_metrics.py WINDOW_US A.npz B.npz [WINDOW_US A.npz B.npz ...]

The first prints the literals of crates/event-metrics/src/tests.rs. Their recordings come from the
integer generator below, which the Rust test repeats, so no data file is needed. The second compares
recordings, one JSON object a line; host-harness/tests/command/metrics_reference.rs runs it. Exit status 77: a
package is missing.

Written from the definitions alone: SSIM by skimage.metrics.structural_similarity, the time distance by
scipy.stats.wasserstein_distance, the matching by scipy.optimize.linear_sum_assignment.
"""

import json
import sys
from collections import Counter

try:
    import numpy as np
    from scipy.optimize import linear_sum_assignment
    from scipy.stats import wasserstein_distance
    from skimage.metrics import structural_similarity
except ImportError as error:
    print(f"{error}: pip install numpy scipy scikit-image", file=sys.stderr)
    sys.exit(77)

WIDTH, HEIGHT, WINDOW_US = 40, 30, 1000


def generator(state):
    """Upper 31 bits of a 64-bit linear congruential generator."""
    while True:
        state = (state * 6364136223846793005 + 1442695040888963407) % 2**64
        yield state >> 33


def recordings(seed):
    """A: 600 events, half of them in 6 x 6 pixels, windows 0, 1, 3 and 4 of 1 ms.
    B: A with events lost, moved in time and added, also before and after A.
    Rows t, x, y, p, in order of time."""
    r = generator(seed)
    a, b = [], []
    for i in range(600):
        t = 5000 + next(r) % 4000
        t += 1000 if t >= 7000 else 0
        side_x, side_y = (6, 6) if i % 2 else (WIDTH, HEIGHT)
        x, y = next(r) % side_x, next(r) % side_y
        event = (t, x, y, next(r) % 2)
        a.append(event)
        fate = next(r) % 6
        if fate == 0:
            continue
        if fate == 1:
            event = (t + next(r) % 300, x, y, event[3])
        b.append(event)
        if fate == 2:
            b.append((5000 + next(r) % 5000, x, y, next(r) % 2))
    b += [(3000, 1, 2, 1), (12500, 3, 4, 0), (12600, 3, 4, 0)]
    return np.array(sorted(a)), np.array(sorted(b))


def load(path):
    """Rows t, x, y, p of an npz file, in order of time; width, height."""
    with np.load(path) as arrays:
        rows = np.stack([arrays[key].astype(np.int64) for key in "txyp"], axis=1)
        size = int(arrays["width"]), int(arrays["height"])
    return rows[np.argsort(rows[:, 0], kind="stable")], size


def frame(events, width, height):
    """Signed sum of polarities per pixel."""
    picture = np.zeros((height, width))
    np.add.at(picture, (events[:, 2], events[:, 1]), 2 * events[:, 3] - 1)
    return picture


def groups(events):
    """Times of every pixel and polarity."""
    order = np.lexsort((events[:, 0], events[:, 3], events[:, 1], events[:, 2]))
    events = events[order]
    starts = np.flatnonzero(np.any(np.diff(events[:, 1:], axis=0), axis=1)) + 1
    parts = np.split(events, starts)
    return {tuple(part[0, 1:].tolist()): part[:, 0] for part in parts if len(part)}


def pixel_cost(a, b, window_us):
    """Least sum of |dt| over the pairs and of window_us for each event without a partner, over the whole recording."""
    total = window_us * (len(a) + len(b))
    groups_a, groups_b = groups(a), groups(b)
    for key in groups_a.keys() | groups_b.keys():
        times_a, times_b = groups_a.get(key, []), groups_b.get(key, [])
        # What a pair saves; one that saves nothing is none.
        cost = np.minimum(np.abs(np.subtract.outer(times_a, times_b)) - 2 * window_us, 0)
        if cost.size:
            total += cost[linear_sum_assignment(cost)].sum()
    return total


def compare(a, b, size, window_us):
    """events_a, events_b, exact_fraction, mse, ssim, emd_time_ms, emd_pixel_us."""
    origin = a[0, 0]
    index_a, index_b = (a[:, 0] - origin) // window_us, (b[:, 0] - origin) // window_us
    span = range(0, int(index_a.max()) + 1)
    windows = sorted(set(span) | set(index_b.tolist()))
    pairs = [(a[index_a == w], b[index_b == w]) for w in windows]
    frames = [(frame(in_a, *size), frame(in_b, *size)) for in_a, in_b in pairs]
    peak = max(np.abs(f).max() for pair in frames for f in pair)
    mse = np.mean([np.mean(((fa - fb) / peak) ** 2) for fa, fb in frames])
    ssim = np.mean([
        structural_similarity(fa / peak, fb / peak, gaussian_weights=True, sigma=1.5,
                              use_sample_covariance=False, data_range=2)
        for fa, fb in frames
    ])
    time = [
        wasserstein_distance(in_a[:, 0] - origin, in_b[:, 0] - origin)
        if len(in_a) and len(in_b) else window_us
        for in_a, in_b in pairs if len(in_a) or len(in_b)
    ]
    exact = Counter(map(tuple, a.tolist())) & Counter(map(tuple, b.tolist()))
    pixel = pixel_cost(a, b, window_us) / len(a)
    exact_fraction = sum(exact.values()) / len(a)
    return len(a), len(b), exact_fraction, mse, ssim, np.mean(time) / 1000, pixel


def main(arguments):
    if not arguments:
        for seed in (1, 2, 3):
            both = recordings(seed)
            events_a, events_b, *numbers = compare(*both, (WIDTH, HEIGHT), WINDOW_US)
            numbers = ", ".join(repr(float(n)) for n in numbers)
            print(f"({seed}, {events_a}, {events_b}, [{numbers}]),")
    for window_us, path_a, path_b in zip(*[iter(arguments)] * 3):
        (a, size), (b, _) = load(path_a), load(path_b)
        events_a, events_b, *numbers = compare(a, b, size, int(window_us))
        keys = "exact_fraction", "mse", "ssim", "emd_time_ms", "emd_pixel_us"
        numbers = dict(zip(keys, map(float, numbers)))
        print(json.dumps({"events_a": events_a, "events_b": events_b, **numbers}))


main(sys.argv[1:])

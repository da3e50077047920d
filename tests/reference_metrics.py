#!/usr/bin/env python3
"""The metrics of `eecvs compare` by numpy, scipy and scikit-image.

    pip install numpy scipy scikit-image
    python3 tests/reference_metrics.py

prints the literals of host-harness/src/metrics/tests.rs. The recordings come from the integer
generator below, which the Rust test repeats, so no data file is needed. Written from the
definitions alone: SSIM by skimage.metrics.structural_similarity, the time distance by
scipy.stats.wasserstein_distance, the matching by scipy.optimize.linear_sum_assignment.
"""

from collections import Counter

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import wasserstein_distance
from skimage.metrics import structural_similarity

WIDTH, HEIGHT, WINDOW_US = 40, 30, 1000


def generator(state):
    """Upper 31 bits of a 64-bit linear congruential generator."""
    while True:
        state = (state * 6364136223846793005 + 1442695040888963407) % 2**64
        yield state >> 33


def recordings(seed):
    """A: 600 events, half of them in 6 x 6 pixels, windows 0, 1, 3 and 4 of 1 ms.
    B: A with events lost, moved in time and added, also before and after A."""
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
    return sorted(a), sorted(b)


def frame(events):
    picture = np.zeros((HEIGHT, WIDTH))
    for _, x, y, p in events:
        picture[y, x] += 2 * p - 1
    return picture


def pixel_cost(a, b):
    total = 0
    groups = {}
    for side, events in enumerate((a, b)):
        for t, x, y, p in events:
            groups.setdefault((x, y, p), ([], []))[side].append(t)
    for times_a, times_b in groups.values():
        total += abs(len(times_a) - len(times_b)) * WINDOW_US
        cost = np.abs(np.subtract.outer(times_a, times_b))
        if cost.size:
            total += cost[linear_sum_assignment(cost)].sum()
    return total


def compare(a, b):
    origin = min(t for t, *_ in a)
    index = lambda event: (event[0] - origin) // WINDOW_US
    span = range(index(a[0]), index(a[-1]) + 1)
    windows = sorted(set(span) | {index(event) for event in b})
    pairs = [([e for e in a if index(e) == w], [e for e in b if index(e) == w]) for w in windows]
    frames = [(frame(in_a), frame(in_b)) for in_a, in_b in pairs]
    peak = max(np.abs(f).max() for pair in frames for f in pair)
    mse = np.mean([np.mean(((fa - fb) / peak) ** 2) for fa, fb in frames])
    ssim = np.mean([
        structural_similarity(fa / peak, fb / peak, gaussian_weights=True, sigma=1.5,
                              use_sample_covariance=False, data_range=2)
        for fa, fb in frames
    ])
    time = [
        wasserstein_distance([e[0] for e in in_a], [e[0] for e in in_b])
        if in_a and in_b else WINDOW_US
        for in_a, in_b in pairs if in_a or in_b
    ]
    exact = sum((Counter(a) & Counter(b)).values()) / len(a)
    pixel = sum(pixel_cost(*pair) for pair in pairs) / len(a)
    return len(a), len(b), exact, mse, ssim, np.mean(time) / 1000, pixel


for seed in (1, 2, 3):
    events_a, events_b, *numbers = compare(*recordings(seed))
    print(f"({seed}, {events_a}, {events_b}, [{', '.join(repr(float(n)) for n in numbers)}]),")

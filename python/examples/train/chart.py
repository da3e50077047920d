"""The chart of IoU against bits per event, as SVG. Needs nothing but Python.

Colours are of the Okabe-Ito set, which colour-blind readers can distinguish; coefficients have circles, arrays of events
squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any
from xml.sax.saxutils import escape

import report

WIDTH, HEIGHT, HEAD = 1380, 520, 84
PANEL = (60, 40)
PANELS = 3
INK, GRID = "#323232", "#E1E1E1"
#: Colour and whether it is an array of events.
SERIES = {
    "dct": ("#D55E00", False),
    "dtft": ("#E69F00", False),
    "dwt": ("#CC79A7", False),
    "auto": ("#0072B2", False),
    "best": ("#965A1E", False),
    "bins": ("#009E73", True),
    "voxel": ("#56B4E9", True),
    "tore": ("#999999", True),
    "ces": ("#F0B429", True),
    "counts": ("#323232", True),
}
BITS = (2, 3, 4, 6, 8, 12, 16, 24, 32)


def _text(x: float, y: float, text: str, anchor: str = "start", size: int = 12) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-family="sans-serif" font-size="{size}" fill="{INK}">'
        f"{escape(text)}</text>"
    )


def _mark(x: float, y: float, colour: str, is_square: bool) -> str:
    if is_square:
        return f'<rect x="{x - 3.5:.1f}" y="{y - 3.5:.1f}" width="7" height="7" fill="{colour}"/>'
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{colour}"/>'


def _panel(left: float, title: str, series: Sequence[tuple[str, list[tuple[float, Any]]]]) -> list[str]:
    width, height = WIDTH / PANELS - PANEL[0] - 15, HEIGHT - HEAD - PANEL[1] - 40
    top = HEAD + 30
    every = [(bits, figure) for _, points in series for bits, figure in points]
    made = [_text(left, top - 10, title, size=13)]
    if not every:
        return [*made, _text(left + width / 2, top + height / 2, "nothing was measured", "middle")]
    low, high = (math.log(edge(bits for bits, _ in every)) for edge in (min, max))
    low, high = low - 0.1, high + 0.1
    least = min(figure.mean - figure.spread for _, figure in every)
    most = max(figure.mean + figure.spread for _, figure in every)
    step = next(step for step in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5) if (most - least) / step <= 8)
    least = max(0.0, math.floor(least / step) * step)
    most = max(math.ceil(most / step) * step, least + step)

    def x(bits: float) -> float:
        return left + width * (math.log(bits) - low) / (high - low)

    def y(value: float) -> float:
        share: float = (max(value, least) - least) / (most - least)
        return top + height * (1 - share)

    for number in range(round((most - least) / step) + 1):
        value = least + number * step
        made.append(f'<path d="M{left} {y(value):.1f}H{left + width:.1f}" stroke="{GRID}"/>')
        made.append(_text(left - 8, y(value) + 4, f"{value:.2f}", "end"))
    for bits in map(float, BITS):
        if low <= math.log(bits) <= high:
            made.append(f'<path d="M{x(bits):.1f} {top}V{top + height:.1f}" stroke="{GRID}"/>')
            made.append(_text(x(bits), top + height + 18, f"{bits:.0f}", "middle"))
    made.append(_text(left + width / 2, top + height + 38, "bits per event", "middle"))
    for name, points in series:
        colour, is_square = SERIES[name]
        line = "L".join(f"{x(bits):.1f} {y(figure.mean):.1f}" for bits, figure in points)
        made.append(f'<path d="M{line}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
        for bits, figure in points:
            ends = (y(figure.mean - figure.spread), y(figure.mean + figure.spread))
            made.append(f'<path d="M{x(bits):.1f} {ends[0]:.1f}V{ends[1]:.1f}" stroke="{colour}"/>')
            made.append(_mark(x(bits), y(figure.mean), colour, is_square))
    return made


def chart(record: report.Record) -> str:
    """Draws IoU against bits per event: on scenes of both kinds, and on recordings with the masks of the original events."""
    m = report.middle(record)
    names = [name for name in SERIES if any(row["input"] == name for row in record["rows"])]
    made = [
        f'<svg width="{WIDTH}" height="{HEIGHT}" viewBox="0 0 {WIDTH} {HEIGHT}" xmlns="http://www.w3.org/2000/svg">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#FFFFFF"/>',
        _text(14, 24, f"IoU of a trained network against bits per event, M = {m}; bars: standard deviation over seeds", size=14),
    ]
    at = 20.0
    for name in names:
        label = report.short(name)
        made += [_mark(at, 50, *SERIES[name]), _text(at + 10, 54, label)]
        at += 30 + 6.6 * len(label)
    titles = {"seen": "seen scene types, other textures", "unseen": "unseen scene types", "recordings": "recordings, with own masks"}
    for number, (of, title) in enumerate(titles.items()):
        series = [(name, report.points(record, name, m, of)) for name in names]
        made += _panel(PANEL[0] + number * WIDTH / PANELS, title, [one for one in series if one[1]])
    return "\n".join([*made, "</svg>", ""])

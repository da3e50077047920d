"""The record as tables and sentences. Needs nothing but Python.

    python python/examples/train/report.py RECORD.json [--save README.md] [--chart iou.svg]
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Union

Record = dict[str, Any]

LABELS = {
    "dct": "DCT",
    "dtft": "DTFT",
    "dwt": "Haar",
    "auto": "by density",
    "best": "best (DCT, few events as times)",
    "bins": "hybrid, bins",
    "voxel": "voxel grid",
    "tore": "TORE",
    "ces": "CES",
    "counts": "counts, without times",
}
FIXED = ("dct", "dtft", "dwt")
SENT = (*FIXED, "auto", "best")
OTHERS = ("voxel", "tore", "ces")
SCENES = ("seen", "unseen")
SETS = {
    "seen": "other textures of the seen scene types",
    "unseen": "unseen scene types",
    "recordings": "recordings, against the masks of the original events",
}
#: Bits per event at which inputs are compared.
BUDGETS = (4, 6, 8, 12, 16)
BEGIN = (
    "<!-- train: python python/examples/train/study.py -o python/examples/train/record --overwrite "
    "--save python/examples/train/README.md -->"
)
END = "<!-- train end -->"


def short(name: str) -> str:
    """Returns an input's label without what is in brackets."""
    return LABELS[name].split(" (")[0]


class Figure(NamedTuple):
    """A figure of each seed's network."""

    by_seed: tuple[float, ...]

    @property
    def mean(self) -> float:
        return statistics.fmean(self.by_seed)

    @property
    def spread(self) -> float:
        """The standard deviation over the seeds; 0 of one."""
        return statistics.stdev(self.by_seed) if len(self.by_seed) > 1 else 0.0

    def __str__(self) -> str:
        return f"{self.mean:.3f} ± {self.spread:.3f}"


def text_of(record: Record) -> str:
    """Returns the record as JSON, a row in each line."""
    rows = ",\n".join(json.dumps(row) for row in record["rows"])
    rest = json.dumps({key: value for key, value in record.items() if key != "rows"})
    return f'{rest[:-1]}, "rows": [\n{rows}\n]}}\n'


def _rows(record: Record, name: str, m: int, setting: Union[str, None], of: str) -> list[dict[str, Any]]:
    # What has no times has no M either.
    m = 2 if name == "counts" else m
    return [
        row
        for row in record["rows"]
        if (row["input"], row["m"], row["setting"], row["set"]) == (name, m, setting, of)
    ]


def _over_sources(rows: Sequence[dict[str, Any]], key: str) -> Union[Figure, None]:
    """Returns the mean over the sources that have a value, of each seed."""
    chosen = [row[key] for row in rows]
    by_seed = []
    for values in zip(*chosen):
        values = tuple(value for value in values if value is not None)
        if not values:
            return None
        by_seed.append(statistics.fmean(values))
    return Figure(tuple(by_seed)) if by_seed else None


def iou(record: Record, name: str, m: int, setting: Union[str, None] = None, of: str = "unseen") -> Union[Figure, None]:
    """Returns the mean IoU over the scenes with moving objects, or over recordings."""
    return _over_sources(_rows(record, name, m, setting, of), "iou")


def falsely_marked(record: Record, name: str, m: int) -> Union[Figure, None]:
    """Returns the share of pixels that are marked in the unseen scenes where nothing moves by itself."""
    still = {source["source"] for source in record["sources"] if source["moving"] == 0 and source["set"] == "unseen"}
    rows = [row for row in _rows(record, name, m, None, "unseen") if row["source"] in still]
    return _over_sources(rows, "marked")


def points(record: Record, name: str, m: int, of: str) -> list[tuple[float, Figure]]:
    """Returns bits per event, the mean over the sources, and IoU of each setting, by ascending bits.

    The record has finer settings first; a coarser one that does not take fewer bits is left out.
    """
    settings = dict.fromkeys(row["setting"] for row in record["rows"] if row["input"] == name)
    found: list[tuple[float, Figure]] = []
    for setting in settings:
        figure = None if setting is None else iou(record, name, m, setting, of)
        if figure is not None:
            bits = statistics.fmean(row["bits"] for row in _rows(record, name, m, setting, of))
            if not found or bits < 0.995 * found[0][0]:
                found.insert(0, (bits, figure))
    return found


def at_bits(record: Record, name: str, m: int, bits: float, of: str) -> Union[Figure, None]:
    """Returns the IoU at a number of bits per event: on the straight line between the two settings around it, or that of the
    most bits if these are fewer; None if all settings take more."""
    found = points(record, name, m, of)
    below = [point for point in found if point[0] <= bits]
    above = [point for point in found if point[0] > bits]
    if not below:
        return None
    if not above:
        return below[-1][1]
    (b0, f0), (b1, f1) = below[-1], above[0]
    share = (bits - b0) / (b1 - b0)
    return Figure(tuple(a + share * (b - a) for a, b in zip(f0.by_seed, f1.by_seed)))


def _cell(figure: Union[Figure, None]) -> str:
    return "-" if figure is None else str(figure)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return ["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *("| " + " | ".join(row) + " |" for row in rows)]


def _names(record: Record) -> list[str]:
    there = {row["input"] for row in record["rows"]}
    return [name for name in LABELS if name in there]


def _ms(record: Record) -> list[int]:
    """Returns the M at which every input was measured."""
    left = {m for _, m in record.get("left", ())}
    return sorted(set(record["protocol"]["m"]) - left)


def middle(record: Record) -> int:
    """Returns the M of the tables that have one: 16 if it was measured."""
    ms = _ms(record)
    return 16 if 16 in ms else ms[0]


def _as_they_are(record: Record) -> list[str]:
    ms, m = _ms(record), middle(record)
    rows = []
    for name in _names(record):
        if name == "best":
            continue
        cells = []
        for of in SCENES:
            of_ms = [_cell(iou(record, name, of_m, of=of)) for of_m in ms]
            cells += of_ms[:1] + [""] * (len(ms) - 1) if name == "counts" else of_ms
        false = falsely_marked(record, name, m)
        rows.append([LABELS[name], *cells, "-" if false is None else f"{100 * false.mean:.2f} %"])
    head = ["input", *(f"{of}, M = {of_m}" for of in SCENES for of_m in ms), f"marked where nothing moves, M = {m}"]
    return _table(head, rows)


def _by_scene(record: Record) -> list[str]:
    m = middle(record)
    scenes = [(s["set"], s["source"]) for s in record["sources"] if s["set"] in SCENES and s["moving"]]
    rows = []
    for name in _names(record):
        if name == "best":
            continue
        of_scenes = [
            _over_sources([row for row in _rows(record, name, m, None, of) if row["source"] == scene], "iou")
            for of, scene in scenes
        ]
        rows.append([LABELS[name], *map(_cell, of_scenes)])
    return _table(["input", *(f"{of}: {scene}" for of, scene in scenes)], rows)


def _equal_bits(record: Record, of: str) -> list[str]:
    m = middle(record)
    rows = [
        [LABELS[name], *(_cell(at_bits(record, name, m, bits, of)) for bits in BUDGETS)] for name in _names(record)
    ]
    return _table(["input", *(f"{bits} bits per event" for bits in BUDGETS)], rows)


def _against(a: Union[Figure, None], b: Union[Figure, None]) -> str:
    """Returns whether a mean is "above" or "below" another by more than either's spread, or "level" with it."""
    if a is None or b is None:
        return "not measured"
    spread = max(a.spread, b.spread)
    difference = a.mean - b.mean
    return "above" if difference > spread else "below" if difference < -spread else "level"


def _verdict(found: Sequence[str]) -> str:
    if not found or "not measured" in found:
        return "is not decided"
    if all(one == "above" for one in found):
        return "holds"
    return "holds in part" if "above" in found else "does not hold"


def _best(of: dict[str, Union[Figure, None]]) -> tuple[str, Union[Figure, None]]:
    measured = [(name, figure) for name, figure in of.items() if figure is not None]
    return max(measured, key=lambda one: one[1].mean) if measured else ("", None)


def _listed(of: dict[str, Union[Figure, None]]) -> str:
    return ", ".join(f"{LABELS[name]} {_cell(figure)}" for name, figure in of.items())


def _ruling(record: Record, of: str, ms: Sequence[int], found: Sequence[str]) -> str:
    """Returns the verdict on a kind of scene types: none where times are not seen to be of use by density."""
    counts = iou(record, "counts", 2, of=of)
    if any(_against(iou(record, "auto", m, of=of), counts) != "above" for m in ms):
        return f"is not decided on {of} scene types, where by density is not above counts without times at every M"
    return f"{_verdict(found)} on {of} scene types"


def _density_against_arrays(record: Record) -> str:
    ms = [m for m in _ms(record) if m != 8] or _ms(record)
    verdicts, figures = [], []
    for of in SCENES:
        found = []
        for m in ms:
            values = {name: iou(record, name, m, of=of) for name in ("auto", "voxel", "ces", "tore")}
            found += [_against(values["auto"], values[name]) for name in ("voxel", "ces")]
            figures.append(f"{of}, M = {m}: {_listed(values)}")
        verdicts.append(_ruling(record, of, ms, found))
    return (
        f"The claim that coefficients by density are better for segmentation than voxel grids and CES (Tables IV and V) "
        f"{' and '.join(verdicts)}: {'; '.join(figures)}."
    )


def _kept(record: Record, name: str, m: int) -> Union[Figure, None]:
    """Returns the share of the IoU of seen scene types that is left on unseen ones."""
    unseen, seen = iou(record, name, m), iou(record, name, m, of="seen")
    if unseen is None or seen is None or not all(seen.by_seed):
        return None
    return Figure(tuple(a / b for a, b in zip(unseen.by_seed, seen.by_seed)))


def _generalisation(record: Record) -> str:
    m = middle(record)
    of = {name: _kept(record, name, m) for name in ("auto", *FIXED, *OTHERS)}
    verdict = _ruling(record, "unseen", [m], [_against(of["auto"], of[name]) for name in OTHERS])
    return (
        f"The claim that they generalise better than voxel grids, TORE and CES {verdict}. Share of the IoU of seen scene types "
        f"that is left on unseen ones, M = {m}: {_listed(of)}."
    )


def _density_against_fixed(record: Record) -> str:
    verdicts, figures = [], []
    for of in SCENES:
        found = []
        for m in _ms(record):
            density = iou(record, "auto", m, of=of)
            name, best = _best({fixed: iou(record, fixed, m, of=of) for fixed in FIXED})
            found.append(_against(density, best))
            figures.append(f"{of}, M = {m}: {_cell(density)} against {_cell(best)} ({LABELS.get(name, '-')})")
        verdicts.append(_ruling(record, of, _ms(record), found))
    return (
        f"The claim that choosing by density is better than any fixed transform {' and '.join(verdicts)}. By density "
        f"against the best fixed one, {'; '.join(figures)}."
    )


def _coefficients_against_events(record: Record, of: str) -> Union[str, None]:
    m, found, figures = middle(record), [], []
    for bits in BUDGETS:
        (name, coefficients), (other, events) = (
            _best({name: at_bits(record, name, m, bits, of) for name in names}) for names in (SENT, ("bins", *OTHERS))
        )
        if coefficients is not None and events is not None:
            found.append(_against(coefficients, events))
            figures.append(f"{bits} bits: {coefficients} ({short(name)}) against {events} ({short(other)})")
    if not found:
        return None
    return (
        f"At equal bits, that coefficients are better than arrays of decoded events {_verdict(found)} on {SETS[of]}. The best "
        f"of each, M = {m}, {'; '.join(figures)}."
    )


def _whether_it_learns(record: Record) -> str:
    m = middle(record)
    (name, seen), (other, unseen) = (
        _best({name: iou(record, name, m, of=of) for name in _names(record) if name != "counts"}) for of in SCENES
    )
    if seen is None or unseen is None:
        return "Nothing was measured."
    carries = (
        "Little of what was learnt carries over, and differences between inputs on unseen types say little."
        if unseen.mean < seen.mean / 2
        else "Most of what was learnt carries over."
    )
    return (
        f"At M = {m}, the best input reaches {seen} ({short(name)}) on other textures of the seen scene types and {unseen} "
        f"({short(other)}) on unseen types, where counts without any times reach {_cell(iou(record, 'counts', m))}. {carries}"
    )


def claims(record: Record) -> list[str]:
    """Returns a sentence for each of the paper's claims: whether it holds here, and by which figures."""
    sentences = [
        _whether_it_learns(record),
        _density_against_arrays(record),
        _generalisation(record),
        _density_against_fixed(record),
        *(_coefficients_against_events(record, of) for of in SETS),
    ]
    return [sentence for sentence in sentences if sentence is not None]


def lines(record: Record) -> list[str]:
    """Returns the tables and sentences as Markdown."""
    m, seeds = middle(record), len(record["protocol"]["seeds"])
    minutes = "" if record["seconds"] is None else f" in {record['seconds'] / 60:.0f} minutes"
    left = ", ".join(f"{short(name)} at M = {m}" for name, m in record.get("left", ()))
    return [
        f"Measured on {record['date']}{minutes}, {record['machine']}, torch {record['torch']}; {seeds} seeds, mean ± standard "
        f"deviation.{' Not measured, as the run was not finished: ' + left + '.' if left else ''}",
        "",
        *(f"* {sentence}" for sentence in claims(record)),
        "",
        "IoU of events as they are, on other textures of the seen scene types and on unseen ones, and the share of pixels "
        "that is marked in unseen scenes where nothing moves by itself:",
        "",
        *_as_they_are(record),
        "",
        f"Scene by scene, M = {m}:",
        "",
        *_by_scene(record),
        *(
            line
            for of, what in SETS.items()
            for line in ("", f"IoU at equal bits, through `encode` and `decode`, M = {m}, {what}:", "", *_equal_bits(record, of))
        ),
    ]


def check_marks(path: Path) -> str:
    """Returns the document's text.

    Raises:
        SystemExit: It does not have the marks once each, in their order.
    """
    text = path.read_text(encoding="utf-8")
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise SystemExit(f"{path}: it does not have the lines {BEGIN!r} and {END!r} once each")
    return text


def put(made: Sequence[str], path: Path) -> None:
    """Puts lines into a document between its marks."""
    before, rest = check_marks(path).split(BEGIN)
    path.write_text("\n".join([before + BEGIN, *made, END]) + rest.split(END)[1], encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("record", type=Path)
    parser.add_argument("--save", type=Path, metavar="FILE.md")
    parser.add_argument("--chart", type=Path, metavar="FILE.svg")
    arguments = parser.parse_args()
    record = json.loads(arguments.record.read_text(encoding="utf-8"))
    made = lines(record)
    print("\n".join(made))
    if arguments.save is not None:
        put(made, arguments.save)
    if arguments.chart is not None:
        import chart

        arguments.chart.write_text(chart.chart(record), encoding="utf-8")


if __name__ == "__main__":
    main()

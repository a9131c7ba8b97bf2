"""Draw docs/validation.svg from the tables of the studies: ``python docs/validation.py``, from the root."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
from scipy.stats import binom

DOCS = Path(__file__).parent
STUDIES = DOCS / "studies"
BLUE, ORANGE = "#2a5d9f", "#c8641e"


@dataclass(frozen=True)
class Coverage:
    """Number of records, and of those whose 90 % interval of frequency and damping ratio holds the true value."""

    name: str
    records: int
    frequency: int
    damping: int


def rows(study: str) -> list[list[str]]:
    """Cells of every row of the tables of a study."""
    lines = (STUDIES / study).read_text(encoding="utf-8").splitlines()
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith("|")]


def series() -> list[Coverage]:
    """Simulated series by case, all of them last; the study states percentages."""
    found = [r for r in rows("coverage.md") if r[1:2] == ["all"]]
    return [
        Coverage(
            f"series: {r[0]}",
            int(r[2]),
            *(round(int(r[2]) * float(r[k].rstrip(" !")) / 100.0) for k in (4, 7)),
        )
        for r in found
    ]


def films() -> list[Coverage]:
    """Rendered, encoded and tracked films by codec."""
    found = [r for r in rows("films.md") if r[1:4] == ["all", "", ""]]
    return [Coverage(f"films: {r[0]}", int(r[4]), int(r[7]), int(r[9])) for r in found]


def strips() -> list[Coverage]:
    """Drawn films of a bare beam in five modes."""
    found = [r for r in rows("lines.md") if len(r) == 11 and r[0] in ("all", "MJPG", "H.264")]
    names = {"all": "lossless"}
    return [Coverage(f"bare beam: {names.get(r[0], r[0])}", int(r[1]), int(r[4]), int(r[8])) for r in found]


def plot(path: Path) -> None:
    """Share of the records whose 90 % interval holds the truth, with the range that 99 % of calibrated ones have."""
    mpl.rcParams.update({"svg.hashsalt": "validation", "svg.fonttype": "none", "font.size": 9})
    studies = [*series(), *films(), *strips()]
    figure, axis = plt.subplots(figsize=(7.2, 5.0), layout="constrained")
    for place, study in enumerate(studies):
        low, high = (100.0 * k / study.records for k in binom.interval(0.99, study.records, 0.9))
        axis.barh(place, high - low, left=low, height=0.7, color="0.88")
        for count, colour, marker, beside in (
            (study.frequency, BLUE, "o", -0.17),
            (study.damping, ORANGE, "D", 0.17),
        ):
            axis.plot(100.0 * count / study.records, place + beside, marker, color=colour, markersize=4)
    axis.axvline(90.0, color="0.4", linewidth=0.8)
    axis.set_yticks(range(len(studies)), [f"{s.name} ({s.records})" for s in studies])
    axis.invert_yaxis()
    axis.set_xlim(58.0, 101.5)
    axis.set_xlabel("records whose 90 % interval contains the true value (%)")
    for colour, marker, label in ((BLUE, "o", "frequency"), (ORANGE, "D", "damping ratio")):
        axis.plot([], [], marker, color=colour, markersize=5, label=label)
    axis.bar(0, 0, color="0.88", label="99 % of calibrated intervals")
    axis.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=3, frameon=False)
    axis.tick_params(left=False)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


if __name__ == "__main__":
    plot(DOCS / "validation.svg")

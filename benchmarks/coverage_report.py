"""Table and rank plot of the coverage study: ``python -m benchmarks.coverage_report FILE.csv ... --docs docs/studies``.

Updates the table in ``coverage.md`` and writes ``coverage.svg`` from the files written by `benchmarks.coverage`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.stats import binom

from benchmarks.coverage import covered
from benchmarks.coverage_cases import CASES

LEVELS = (0.5, 0.9, 0.99)
BINS = 20
BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"


def cell(ranks: np.ndarray, level: float) -> str:
    """Format the coverage in percent, with an exclamation mark if it is outside the binomial 99 % band."""
    hits, low_high = covered(ranks, level), binom.interval(0.99, ranks.size, level)
    mark = "" if low_high[0] <= hits <= low_high[1] else " !"
    return f"{100.0 * hits / ranks.size:.1f}{mark}"


def row(case: str, mode: str, part: pd.DataFrame) -> str:
    """Format one row of the table."""
    cells = [
        cell(part[name].to_numpy(float), level)
        for name in ("rank_frequency", "rank_zeta")
        for level in LEVELS
    ]
    error = np.sqrt(np.mean((part["zeta_found"] / part["zeta"] - 1.0) ** 2))
    sd = np.mean(part["zeta_sd"] / part["zeta"])
    return (
        f"| {case} | {mode} | {len(part)} | {' | '.join(cells)} | "
        f"{100.0 * error:.3f} / {100.0 * sd:.3f} | {int(part['rank_zeta'].isna().sum())} |"
    )


def table(trials: pd.DataFrame) -> str:
    """Format the Markdown table with one row per case and mode."""
    head = "| case | mode | decays | " + " | ".join(
        f"{name} {level:.0%}" for name in ("f", "zeta") for level in LEVELS
    )
    lines = [head + " | zeta rms error / mean sd, % | failed |", "| --- " * 11 + "|"]
    for case in CASES:
        of_case = trials[trials["case"] == case]
        if of_case.empty:
            continue
        lines.append(row(case, "all", of_case))
        lines += [row("", str(mode), part) for mode, part in of_case.groupby("mode")]
    lines.append(row("every case", "all", trials))
    return "\n".join(lines)


def plot(trials: pd.DataFrame, path: Path) -> None:
    """Plot rank histograms with the band that contains 99 % of the bars of a calibrated posterior."""
    mpl.rcParams.update({"svg.hashsalt": "coverage", "svg.fonttype": "none"})
    figure, axes = plt.subplots(3, 3, figsize=(9.0, 6.5), sharex=True, layout="constrained")
    for axis, case in zip(axes.flat, CASES, strict=True):
        part = trials[trials["case"] == case]
        low, high = binom.interval(0.99, len(part), 1.0 / BINS)
        axis.axhspan(low, high, color="0.88", lw=0)
        for name, colour in (("rank_frequency", "tab:blue"), ("rank_zeta", "tab:orange")):
            count, edges = np.histogram(part[name].dropna(), BINS, (0.0, 1.0))
            axis.stairs(count, edges, color=colour, label={"rank_frequency": "f", "rank_zeta": "zeta"}[name])
        axis.set_title(f"{case} ({len(part)})", fontsize=9)
        axis.set_ylim(0.0, None)
    axes[0, 0].legend(fontsize=8)
    figure.supxlabel("rank of the truth in its posterior")
    figure.supylabel("decays a bin")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def main() -> None:
    """Write the table and the plot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--docs", type=Path, default=Path("docs/studies"))
    options = parser.parse_args()
    trials = pd.concat([pd.read_csv(path) for path in options.files], ignore_index=True)
    page = options.docs / "coverage.md"
    text = page.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    page.write_text(f"{before}{BEGIN}\n{table(trials)}\n{END}{after}", encoding="utf-8")
    plot(trials, options.docs / "coverage.svg")


if __name__ == "__main__":
    main()

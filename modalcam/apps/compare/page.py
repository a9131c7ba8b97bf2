"""A comparison of runs in the terminal, as tables for other programs and as one HTML page."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Column, Table

from modalcam.apps.compare.compare import Comparison, ModeInRuns, Quantity
from modalcam.common import csv_safe, for_terminal
from modalcam.pipeline import write_json, write_text
from modalcam.report.style import (
    ALERT,
    MEASURED,
    FigureView,
    environment,
    few_ticks,
    figure_label,
    figure_style,
    figure_svg,
    inline,
    new_figure,
    p_value,
    significant,
    style_sheet,
    with_sd,
)
from modalcam.tables import jsonable

FILES = ("compare.csv", "compare.json", "compare.html")
_NAMES = {"frequency_hz": ("Frequency", "Hz", 1.0), "damping_ratio": ("Damping ratio", "%", 100.0)}
# What the columns of the tables hold in the row of a run, and in the last row of a mode.
HEADINGS = ("value ± sd", "difference ± sd", "p")
MEAN = "mean, sd between runs"
_CAVEAT = (
    "Differences are from the first run, p is that of no difference. Mean: with the scatter between runs beyond their "
    "standard deviations, its 90 % interval in brackets, and p of agreement; below 0.01 the runs differ by more than "
    "they state."
)


def show(comparison: Comparison, console: Console) -> None:
    """Print a table for frequencies and one for damping ratios."""
    for name, (title, unit, _) in _NAMES.items():
        table = Table(Column("mode"), Column("run", overflow="fold"), box=SIMPLE_HEAD, pad_edge=False)
        for heading in HEADINGS:
            table.add_column(f"{heading} / {unit}" if "sd" in heading else heading)
        for mode in comparison.modes:
            for row in cells_of(mode.quantity(name)):
                table.add_row(mode.name, *map(for_terminal, row), end_section=row[0] == MEAN)
        console.print(title, style="bold")
        console.print(table)
    for text in (*comparison.notes, _CAVEAT):
        console.print(for_terminal(text), markup=False, highlight=False)


def cells_of(quantity: Quantity) -> list[tuple[str, str, str, str]]:
    """Run, value, difference and p as text for each run, and the same of the mean with the scatter between runs."""
    scale = _NAMES[quantity.name][2]
    lines = [
        (
            run.run,
            with_sd(scale * run.value, scale * run.sd),
            "" if math.isnan(run.difference) else with_sd(scale * run.difference, scale * run.difference_sd),
            "" if math.isnan(run.p_value) else p_value(run.p_value, 0.001),
        )
        for run in quantity.runs
    ]
    found = quantity.combined
    between, low, high = (
        significant(scale * sd, 2) for sd in (found.between_sd, quantity.between_low, quantity.between_high)
    )
    mean = with_sd(scale * found.value, scale * found.sd)
    return [*lines, (MEAN, mean, f"{between} ({low} … {high})", p_value(found.p_value, 0.001))]


def rows(comparison: Comparison) -> list[dict[str, Any]]:
    """One row for each mode, quantity and run: value, difference from the first run, scatter over all runs."""
    return [
        {
            "mode": mode.number,
            "quantity": quantity.name,
            "run": run.run,
            "recordings": "|".join(run.recordings),
            "value": run.value,
            "sd": run.sd,
            "difference": run.difference,
            "difference_q05": run.interval[0],
            "difference_q95": run.interval[1],
            "difference_p": run.p_value,
            "mean": quantity.combined.value,
            "mean_sd": quantity.combined.sd,
            "between_sd": quantity.combined.between_sd,
            "between_q05": quantity.between_low,
            "between_q95": quantity.between_high,
            "agreement_p": quantity.combined.p_value,
        }
        for mode in comparison.modes
        for quantity in (mode.frequency, mode.damping)
        for run in quantity.runs
    ]


def write_files(comparison: Comparison, folder: Path) -> None:
    """Write `FILES` into `folder`."""
    table, text = rows(comparison), io.StringIO()
    writer = csv.DictWriter(text, list(table[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {name: csv_safe(v) if isinstance(v, str) else v for name, v in row.items()} for row in table
    )
    write_text(folder / FILES[0], text.getvalue())
    write_json(folder / FILES[1], jsonable(comparison))
    write_text(folder / FILES[2], page(comparison))


def page(comparison: Comparison) -> str:
    """One HTML page: no script, nothing to load, the same bytes for the same runs."""
    template = environment(("modalcam.apps.compare", "templates")).get_template("compare.html.j2")
    return template.render(
        css=style_sheet(),
        comparison=comparison,
        figures=[_figure(k, mode) for k, mode in enumerate(comparison.modes)],
        names=_NAMES,
        headings=HEADINGS,
        cells_of=cells_of,
        caveat=_CAVEAT,
    )


def _figure(index: int, mode: ModeInRuns) -> FigureView:
    """Values of the runs with their 90 % intervals, and the interval of their mean."""
    quantities = (mode.frequency, mode.damping)
    with figure_style():
        figure = new_figure(1.1 + 0.22 * len(mode.frequency.runs))
        for axes, quantity in zip(figure.subplots(1, 2), quantities, strict=True):
            _draw(axes, quantity)
        figure.axes[1].set_yticklabels([])
        svg = figure_svg(figure)
    alt = (
        f"Frequencies and damping ratios of {mode.name} in {len(mode.frequency.runs)} runs, as in the tables."
    )
    figure_id = f"mode-{index}"
    caption = (
        "Points: runs with 90 % intervals. Band: 90 % interval of their mean, scatter between runs included."
    )
    title = f"{mode.name[0].upper()}{mode.name[1:]}"
    return FigureView(figure_id, "runs", title, inline(svg, figure_id, alt), caption)


def _draw(axes: Axes, quantity: Quantity) -> None:
    name, unit, scale = _NAMES[quantity.name]
    mean, reach = quantity.combined.value, 1.645 * quantity.combined.sd
    axes.axvspan(scale * (mean - reach), scale * (mean + reach), color=ALERT, alpha=0.15, linewidth=0)
    for k, run in enumerate(quantity.runs):
        ends = [scale * (run.value + sign * 1.645 * run.sd) for sign in (-1.0, 1.0)]
        axes.plot(ends, [k, k], color=MEASURED, linewidth=1.5)
        axes.plot([scale * run.value], [k], "o", color=MEASURED, markersize=5)
    few_ticks(axes, x=5)
    axes.set(xlabel=f"{name.lower()} ({unit})", ylim=(len(quantity.runs) - 0.4, -0.6))
    axes.set_yticks(range(len(quantity.runs)), [figure_label(run.run)[:24] for run in quantity.runs])

"""Differences of the modes between finished runs beside their standard deviations, in the terminal and as one page.

The modes are read from `summary.json`, so that results of other versions of modalcam can be compared, too.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Column, Table
from scipy.special import ndtr

from modal_id.modes import Combined, between_interval, combine
from modalcam.common import InputError, csv_safe, for_terminal, natural_key, readable_bytes, real, shown
from modalcam.pipeline import Workspace, write_json, write_text
from modalcam.report.figures import BAND_SD
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
from tracker import INTERVAL_SD

_MOST_BYTES = 500_000_000


@dataclass(frozen=True)
class Tuning:
    """Thresholds of the comparison."""

    #: [1] modes without a number that differ by more are different modes
    #: convention: Chosen; mode 5 of a cantilever has 1.65 times the frequency of mode 4, its nearest.
    same_frequency: float = 0.05
    #: [1] largest over smallest amplitude of runs above which a mode that depends on it gets a note
    similar: float = 1.2


TUNING = Tuning()


@dataclass(frozen=True)
class RunMode:
    """A mode that was excited in one recording of one run.

    `frequency_sd_hz` does not include the error of the clock, `clock_sd_hz`, which the recordings of a run share.
    `number` is None where it is unknown, and `sha256`, of the recording, empty.
    """

    run: str
    recording: str
    number: int | None
    frequency_hz: float
    frequency_sd_hz: float
    clock_sd_hz: float
    damping_ratio: float
    damping_ratio_sd: float
    amplitude: float
    amplitude_unit: str
    flags: tuple[str, ...]
    sha256: str = ""


def run_modes(out: Path, label: str, *, small_amplitude: bool = False) -> tuple[RunMode, ...]:
    """Modes of a run at the amplitudes of its recordings or at small amplitude.

    InputError if `out` does not hold a run with a mode.
    """
    path = Workspace(out).summary
    readable_bytes(path, _MOST_BYTES)
    try:
        tree = json.loads(path.read_text("utf-8"))
        clocks = [(budget["recording"], budget["clock_hz"]) for budget in tree["uncertainty"]]
        # Budgets stand in the order of the modes.
        modes = [(recording, mode) for recording in tree["recordings"] for mode in recording["modes"]]
        at = "small_amplitude_" if small_amplitude else ""
        found = [
            replace(
                _mode(label, recording["recording"], mode, clock, at), sha256=str(recording.get("sha256", ""))
            )
            for (recording, mode), (_, clock) in zip(modes, clocks, strict=True)
            if mode["target"]
        ]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        msg = f"{shown(str(path))}: expected values and standard deviations of the modes of a run; run again"
        raise InputError(msg) from error
    if not found:
        msg = f"{shown(str(out))}: expected a run with identified modes, found none; see its report"
        raise InputError(msg)
    return tuple(found)


def _mode(run: str, recording: str, mode: dict[str, Any], clock_hz: float, at: str) -> RunMode:
    """The mode with its values named by `at`; ValueError where they cannot be compared."""
    total = float(mode[f"frequency_{at}sd_hz"])
    found = RunMode(
        run,
        str(recording),
        None if mode["mode"] is None else int(mode["mode"]),
        float(mode[f"frequency_{at}hz"]),
        # Above zero where rounding would leave nothing.
        float(np.sqrt(max(total**2 - clock_hz**2, 1e-6 * total**2))),
        float(clock_hz),
        float(mode[f"damping_ratio_{at}".rstrip("_")]),
        float(mode[f"damping_ratio_{at}sd"]),
        float(mode["amplitude"]),
        str(mode["amplitude_unit"]),
        tuple(map(str, mode["flags"])),
    )
    values = (found.frequency_hz, found.frequency_sd_hz, found.damping_ratio_sd)
    if not np.isfinite(found.damping_ratio) or not all(0.0 < value < np.inf for value in values):
        raise ValueError
    return found


def same_modes(modes: list[RunMode]) -> list[tuple[RunMode, ...]]:
    """Modes grouped by their number, those without one with the nearest within 5 %; by frequency."""
    groups: list[list[RunMode]] = []
    for mode in sorted(modes, key=lambda m: (m.number is None, m.number or 0, m.frequency_hz)):
        distance = [abs(np.log(mode.frequency_hz / np.mean([m.frequency_hz for m in g]))) for g in groups]
        fits = [
            k
            for k, group in enumerate(groups)
            if (
                mode.number == group[0].number
                if mode.number is not None
                else distance[k] < TUNING.same_frequency
            )
        ]
        if fits:
            groups[min(fits, key=lambda k: distance[k])].append(mode)
        else:
            groups.append([mode])
    return sorted(map(tuple, groups), key=lambda group: group[0].frequency_hz)


@dataclass(frozen=True)
class RunValue:
    """Value of one run, combined over its recordings, and its difference from the first run, NaN in that run.

    `sd` includes the scatter between the recordings of the run; `p_value` is that of no difference, two-sided.
    """

    run: str
    recordings: tuple[str, ...]
    value: float
    sd: float
    difference: float = float("nan")
    difference_sd: float = float("nan")
    p_value: float = float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """90 % interval of the difference."""
        reach = INTERVAL_SD * self.difference_sd
        return self.difference - reach, self.difference + reach


@dataclass(frozen=True)
class Quantity:
    """Frequency or damping ratio of one mode in all runs.

    `name` is ``frequency_hz`` or ``damping_ratio``; `between_low` and `between_high` are the 90 % interval of the
    standard deviation between runs.
    """

    name: str
    runs: tuple[RunValue, ...]
    combined: Combined
    between_low: float
    between_high: float


@dataclass(frozen=True)
class ModeInRuns:
    """One mode: its frequency and its damping ratio in all runs; `number` is None where no run knows it."""

    number: int | None
    frequency: Quantity
    damping: Quantity

    @property
    def name(self) -> str:
        """The mode as tables name it."""
        return f"{self.frequency.combined.value:.4g} Hz" if self.number is None else f"mode {self.number}"

    def quantity(self, name: str) -> Quantity:
        """``frequency_hz`` or ``damping_ratio``."""
        return next(quantity for quantity in (self.frequency, self.damping) if quantity.name == name)


@dataclass(frozen=True)
class Comparison:
    """Modes that several runs have, and sentences on what can be compared only in part."""

    runs: tuple[str, ...]
    modes: tuple[ModeInRuns, ...]
    notes: tuple[str, ...]


def compare_runs(
    folders: Sequence[Path], *, same_camera: bool = False, small_amplitude: bool = False
) -> Comparison:
    """Compare the modes of finished runs with those of the first.

    Parameters
    ----------
    folders : sequence of Path
        Folders of results of at least two runs.
    same_camera : bool
        The error of the frame rate is the same in all runs, so that differences do not contain it.
    small_amplitude : bool
        Compare values at small amplitude, which do not depend on how far the beam was deflected but are less precise.

    Raises
    ------
    InputError
        If there are fewer than two folders, one is given twice, one holds no identified mode, or the runs have no mode
        in common.
    """
    if len(folders) < 2 or len({real(folder) for folder in folders}) < len(folders):
        msg = "expected the results of at least two runs, each once"
        raise InputError(msg)
    labels = _labels(folders)
    found = [
        mode
        for out, label in zip(folders, labels, strict=True)
        for mode in _once(run_modes(out, label, small_amplitude=small_amplitude))
    ]
    groups = same_modes(found)
    common = [group for group in groups if len({mode.run for mode in group}) > 1]
    if not common:
        listed = "; ".join(f"{m.run}: {m.frequency_hz:.4g} Hz" for m in found)
        msg = f"the runs have no mode in common ({listed}); give the modes' numbers in experiment.toml"
        raise InputError(msg)
    modes = tuple(_in_runs(group, labels, same_camera=same_camera) for group in common)
    notes = [
        f"{group[0].frequency_hz:.4g} Hz was identified in {group[0].run} alone."
        for group in groups
        if group not in common
    ]
    notes += _in_several(found)
    if not small_amplitude:
        notes += [
            note for group, mode in zip(common, modes, strict=True) for note in _of_amplitude(group, mode)
        ]
    return Comparison(labels, modes, tuple(notes))


def _once(modes: Sequence[RunMode]) -> list[RunMode]:
    """The modes of one run without those of a recording whose content another has: it is one measurement."""
    seen: set[tuple[str, int | None]] = set()
    kept = []
    for mode in modes:
        if not mode.sha256 or (mode.sha256, mode.number) not in seen:
            kept.append(mode)
        seen.add((mode.sha256, mode.number))
    return kept


def _in_several(found: Sequence[RunMode]) -> list[str]:
    """A sentence where runs share a recording: their values are not independent."""
    runs_of: dict[str, set[str]] = {}
    for mode in found:
        runs_of.setdefault(mode.sha256, set()).add(mode.run)
    shared = sorted({m.recording for m in found if m.sha256 and len(runs_of[m.sha256]) > 1}, key=natural_key)
    if not shared:
        return []
    words = "the same recording in several runs, one measurement analysed more than once"
    return [
        f"{', '.join(shared)}: {words}. Differences are those of the analysis; the combined value counts it once."
    ]


def _labels(folders: Sequence[Path]) -> tuple[str, ...]:
    """The folders' names where they differ, else their paths."""
    names = [shown(real(folder).name) for folder in folders]
    return tuple(names if len(set(names)) == len(names) else [shown(str(folder)) for folder in folders])


def _in_runs(group: Sequence[RunMode], labels: Sequence[str], *, same_camera: bool) -> ModeInRuns:
    by_run = [(label, [mode for mode in group if mode.run == label]) for label in labels]
    by_run = [(label, modes) for label, modes in by_run if modes]

    def clock(modes: list[RunMode]) -> float:
        return 0.0 if same_camera else max(mode.clock_sd_hz for mode in modes)

    frequency = [
        _run_value(label, modes, lambda m: (m.frequency_hz, m.frequency_sd_hz), clock(modes))
        for label, modes in by_run
    ]
    damping = [
        _run_value(label, modes, lambda m: (m.damping_ratio, m.damping_ratio_sd)) for label, modes in by_run
    ]
    numbers = [mode.number for mode in group if mode.number is not None]
    seen: set[str] = set()
    distinct = []
    for k, (_, modes) in enumerate(by_run):
        hashes = {mode.sha256 for mode in modes if mode.sha256}
        if not hashes & seen:
            distinct.append(k)
        seen |= hashes
    return ModeInRuns(
        numbers[0] if numbers else None,
        _quantity("frequency_hz", frequency, distinct),
        _quantity("damping_ratio", damping, distinct),
    )


def _run_value(
    run: str, modes: list[RunMode], of: Callable[[RunMode], tuple[float, float]], common_sd: float = 0.0
) -> RunValue:
    values, sds = zip(*map(of, modes), strict=True)
    found = combine(values, sds)
    recordings = tuple(sorted((mode.recording for mode in modes), key=natural_key))
    return RunValue(run, recordings, found.value, float(np.hypot(found.sd, common_sd)))


def _quantity(name: str, runs: Sequence[RunValue], distinct: Sequence[int]) -> Quantity:
    """Values of all runs, compared with the first; those of the `distinct` ones, which share no recording, combined."""
    first = runs[0]
    values, sds = [runs[k].value for k in distinct], [runs[k].sd for k in distinct]
    compared = [first]
    for run in runs[1:]:
        difference, sd = run.value - first.value, float(np.hypot(run.sd, first.sd))
        p_value = float(2.0 * ndtr(-abs(difference) / sd))
        compared.append(RunValue(run.run, run.recordings, run.value, run.sd, difference, sd, p_value))
    return Quantity(name, tuple(compared), combine(values, sds), *between_interval(values, sds))


def _of_amplitude(group: Sequence[RunMode], mode: ModeInRuns) -> list[str]:
    """Sentence on a mode that depends on the amplitude, where the runs have different ones."""
    largest: dict[str, tuple[float, str]] = {}
    for one in group:
        largest[one.run] = max(largest.get(one.run, (0.0, "")), (one.amplitude, one.amplitude_unit))
    dependent = any("AMPLITUDE_DEPENDENT" in one.flags for one in group)
    amplitudes, units = zip(*largest.values(), strict=True)
    if not dependent or (len(set(units)) == 1 and max(amplitudes) < TUNING.similar * min(amplitudes)):
        return []
    listed = ", ".join(f"{run} {amplitude:.3g} {unit}" for run, (amplitude, unit) in largest.items())
    return [
        f"{mode.name} depends on its amplitude, which differs ({listed}): compare with --small-amplitude."
    ]


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
    mean, reach = quantity.combined.value, BAND_SD * quantity.combined.sd
    axes.axvspan(scale * (mean - reach), scale * (mean + reach), color=ALERT, alpha=0.15, linewidth=0)
    for k, run in enumerate(quantity.runs):
        ends = [scale * (run.value + sign * BAND_SD * run.sd) for sign in (-1.0, 1.0)]
        axes.plot(ends, [k, k], color=MEASURED, linewidth=1.5)
        axes.plot([scale * run.value], [k], "o", color=MEASURED, markersize=5)
    few_ticks(axes, x=5)
    axes.set(xlabel=f"{name.lower()} ({unit})", ylim=(len(quantity.runs) - 0.4, -0.6))
    axes.set_yticks(range(len(quantity.runs)), [figure_label(run.run)[:24] for run in quantity.runs])

"""All tables and figures of the paper with those of a folder: one HTML file with SVG, the terminal and JSON.

The paper's claims are listed, each with its verdict for these numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import unescape
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike
from rich.console import Console
from rich.table import Table
from rich.text import Text

from modalcam.apps.paper import tables
from modalcam.apps.paper.recomputed import (
    HANDBOOK_DENSITY_KG_M3,
    Recomputed,
    TrueMode,
    beam_differences,
    read_truth,
    recomputed,
)
from modalcam.apps.paper.tables import Decay, Measured
from modalcam.pipeline import Progress, RunResult, Workspace, write_text
from modalcam.report import best_modes, measured_envelope, shown_channel
from modalcam.report.figures import (
    DAMPING,
    SIMULATED,
    DampingPoint,
    Reference,
    damping_shown,
    measured_point,
    simulated_shown,
)
from modalcam.report.sections import findings
from modalcam.report.style import (
    ALERT,
    FIT,
    MEASURED,
    MISSING,
    MUTED,
    RAYLEIGH,
    FigureView,
    dots,
    environment,
    few_ticks,
    figure_style,
    figure_svg,
    fixed,
    inline,
    interval,
    legend_above,
    listed,
    log_y,
    new_figure,
    percent,
    significant,
    style_sheet,
    with_sd,
)
from modalcam.tables import jsonable
from sim import reference as printed
from sim.damping import DAMPING_MODELS
from sim.updating import PaperUpdate
from tracker import Failure, FloatArray

_COLUMNS = 3


def damping_ratios(
    result: RunResult, measured: Sequence[Measured], shown: Sequence[Decay], paper: Recomputed
) -> FigureView | None:
    """Damping ratio against frequency: printed, measured and simulated."""
    points = [measured_point(row.mode) for row in measured if row.mode is not None]
    table = zip(printed.TABLE_2_FREQUENCY_HZ, printed.TABLE_2_DAMPING_RATIO, strict=True)
    own = tuple(DampingPoint(f, z) for f, z in table)
    reference = Reference("paper, Table 2", own, paper.equations.alpha_1_s, paper.equations.beta_s)
    simulated = [(model, decay.mode.damping_ratio) for decay in shown for model in decay.models]
    data = damping_shown(points, simulated, result.beam, reference)
    return None if data is None else DAMPING.view("paper-damping", data)


def decay_figures(shown: Sequence[Decay]) -> list[tuple[Decay, FigureView]]:
    """Each decay with its figure."""
    out = []
    for decay in shown:
        channel = decay.found.series.channels[shown_channel(decay.found)]
        data = simulated_shown(decay.comparison, channel)
        view = None if data is None else SIMULATED.view(f"paper-decay-{decay.number}", data)
        if view is not None:
            out.append((decay, view))
    return out


def envelopes(shown: Sequence[Decay]) -> str:
    """SVG of the amplitude of each decay on a logarithmic axis: measured, and with the damping of each simulation."""
    rows = -(-len(shown) // _COLUMNS)
    with figure_style():
        figure = new_figure(0.5 + 1.9 * rows)
        panels = figure.subplots(rows, min(_COLUMNS, len(shown)), squeeze=False).ravel()
        for axes, decay in zip(panels, shown, strict=False):
            _envelope(axes, decay)
        for axes in panels[len(shown) :]:
            axes.set_axis_off()
        figure.supxlabel("time since the start of the fit (s)", fontsize=8.5)
        figure.supylabel(f"amplitude ({shown[0].found.series.unit})", fontsize=8.5)
        legend_above(figure, panels[0].get_legend_handles_labels(), columns=3)
        return figure_svg(figure)


def _envelope(axes: Axes, decay: Decay) -> None:
    channel = shown_channel(decay.found)
    mode, start = decay.mode, decay.found.onset.fit_from_s
    time_s, amplitude = measured_envelope(decay.found, mode, channel)
    size = float(np.abs(mode.shape[channel]))
    end = float(time_s[-1]) - start if time_s.size else 1.0 / mode.frequency_hz
    axis_s = np.linspace(0.0, end, 40)

    def line(ratio: float) -> FloatArray:
        return np.asarray(size * np.exp(-ratio * mode.omega_n_rad_s * axis_s))

    high, low = (line(ratio) for ratio in mode.damping_interval())
    axes.fill_between(axis_s, low, high, color=MEASURED, alpha=0.3, linewidth=0)
    positive = amplitude > 0.0
    dots(axes, time_s[positive] - start, amplitude[positive], MEASURED, 2.6, label="measured")
    for model in decay.models:
        entry, values = DAMPING_MODELS[model.model], line(model.damping_ratio)
        if np.all(np.isfinite(values)):
            axes.plot(axis_s, values, entry.line_style, color=entry.colour, linewidth=1.5, label=entry.name)
    few_ticks(axes, x=4)
    log_y(axes, (1.0, 2.0, 5.0))
    # Two decades at most: below are noise and lines far from the dots.
    lowest = 0.5 * float(min(low[-1], amplitude[positive].min(initial=size)))
    axes.set(title=f"Mode {decay.number} ({decay.panel})", ylim=(max(size * 1e-2, lowest), 1.6 * size))


def variables(update: PaperUpdate) -> str:
    """SVG of the fitted width and thickness of each element, with the bound."""
    edges_mm = np.linspace(0.0, 1e3 * update.properties.length_m, update.width_factor.size + 1)
    middle_mm = 0.5 * (edges_mm[1:] + edges_mm[:-1])
    limit = 100.0 * update.bound
    with figure_style():
        figure = new_figure(2.3)
        axes = figure.subplots()
        for value, label in ((-limit, "_"), (limit, "bound")):
            axes.axhline(value, color=ALERT, linewidth=1.0, linestyle=(0, (1, 2)), label=label)
        axes.axhline(0.0, color=MUTED, linewidth=0.7)
        for factors, colour, dash, label in (
            (update.thickness_factor, FIT, "-", "thickness"),
            (update.width_factor, RAYLEIGH, "--", "width"),
        ):
            change = 100.0 * (factors - 1.0)
            axes.stairs(
                change, edges_mm, baseline=None, label=label, color=colour, linewidth=1.4, linestyle=dash
            )
            at = np.abs(np.abs(change) - limit) < 1e-4
            axes.plot(middle_mm[at], change[at], "s", color=colour, markersize=4.0)
        few_ticks(axes, x=10)
        axes.set(
            xlabel="distance from the clamp (mm)", ylabel="change (%)", ylim=(-1.35 * limit, 1.35 * limit)
        )
        legend_above(figure, columns=3)
        return figure_svg(figure)


def signed_percent(ratio: float) -> str:
    """``+0.62 %``: a relative difference to two significant digits; a dash for NaN."""
    if np.isnan(ratio):
        return MISSING
    text = significant(100.0 * ratio, 2)
    return f"{'+' if ratio > 0.0 and text != '0' else ''}{text} %"


def signed_range(ratios: ArrayLike) -> str:
    """``−3.1 to +2.8 %``, smallest to largest, without NaN; one value where both read the same."""
    finite = _finite(ratios)
    if finite.size == 0:
        return MISSING
    low, high = (signed_percent(float(v)) for v in (finite.min(), finite.max()))
    return low if low == high else f"{low.removesuffix(' %')} to {high}"


def percent_range(ratios: ArrayLike) -> str:
    """``0.48 to 15 %``, without signs."""
    return signed_range(np.abs(ratios)).replace("+", "")


def within(ratios: ArrayLike) -> str:
    """Largest absolute value in per cent, at least 0.0001 %; a dash if all are NaN."""
    value = largest(ratios)
    return "0.0001 %" if value < 1e-6 else percent(value)


def error(ratio: float) -> str:
    """As `signed_percent`; errors below any measurement as ``< 0.0001 %``."""
    return "< 0.0001 %" if abs(ratio) < 1e-6 else signed_percent(ratio)


def largest(ratios: ArrayLike) -> float:
    """Largest absolute value, without NaN; NaN if all are."""
    finite = np.abs(_finite(ratios))
    return float(finite.max()) if finite.size else float("nan")


def _finite(ratios: ArrayLike) -> FloatArray:
    values = np.atleast_1d(np.asarray(ratios, dtype=np.float64))
    return np.asarray(values[np.isfinite(values)])


def column(rows: Iterable[object], name: str) -> FloatArray:
    """One attribute of all rows."""
    return np.array([attrgetter(name)(row) for row in rows])


def of_all(part: int, total: int) -> str:
    """``all 5``, ``3 of 5``, ``none of 5``."""
    if part == total:
        return f"all {total}" if total != 1 else "the one"
    return f"{part or 'none'} of {total}"


def numbered(numbers: Sequence[int], noun: str) -> str:
    """``mode 3``, ``modes 3 to 5``, ``modes 1, 3 and 5``: three or more consecutive numbers as a range."""
    runs: list[list[int]] = []
    for n in numbers:
        if runs and n == runs[-1][-1] + 1:
            runs[-1].append(n)
        else:
            runs.append([n])
    parts: list[str] = []
    for run in runs:
        parts += [f"{run[0]} to {run[-1]}"] if len(run) > 2 else map(str, run)
    return f"{noun}{'s' if len(numbers) > 1 else ''} {listed(parts)}"


def exponential(value: float) -> float:
    """Exponential function; infinite beyond the largest number, for odds of any size."""
    with np.errstate(over="ignore"):
        return float(np.exp(value))


FILTERS = (
    column,
    error,
    exponential,
    inline,
    largest,
    numbered,
    of_all,
    percent_range,
    signed_percent,
    signed_range,
    within,
)


class Check(NamedTuple):
    """One claim: where the page has its numbers, whether it "holds", "does not hold" or was "not checked", and why."""

    anchor: str
    verdict: str
    claim: str
    finding: str

    @property
    def holds(self) -> bool | None:
        """None if the folder has nothing to check it with."""
        return {"holds": True, "does not hold": False}.get(self.verdict)

    @property
    def state(self) -> str:
        """Class of the line on the page."""
        return {"holds": "good", "does not hold": "care"}.get(self.verdict, "none")


def checks(
    table: Sequence[tables.Measured], shown: Sequence[tables.ModelRow], paper: Recomputed
) -> tuple[Check, ...]:
    """All claims, in the paper's order."""
    text = templates().get_template("checks.txt.j2").render(table=table, shown=shown, **numbers_of(paper))
    return tuple(Check(*unescape(line).split(" | ")) for line in text.splitlines() if line)


def templates() -> jinja2.Environment:
    """Templates of the page and of the checks."""
    made = environment(("modalcam.apps.paper", "templates"))
    made.filters |= {text_filter.__name__: text_filter for text_filter in FILTERS}
    return made


def numbers_of(paper: Recomputed) -> dict[str, object]:
    """The paper's numbers as the templates name them."""
    return {
        "paper": paper,
        "printed": printed,
        "handbook": HANDBOOK_DENSITY_KG_M3,
        "standard": np.array(printed.TABLE_3_STANDARD_HZ),
        "optimum": np.array(printed.TABLE_3_OPTIMUM_HZ),
        "test": np.array(printed.TABLE_3_TEST_HZ),
    }


_STYLES = {"good": "green", "care": "yellow", "none": "dim"}


@dataclass(frozen=True)
class PaperPage:
    """Content of the page; numbers are formatted by the template."""

    result: RunResult
    paper: Recomputed
    truth: dict[int, TrueMode] | Failure
    checks: tuple[Check, ...]
    table1: tuple[tables.Column, ...]
    table2: tuple[tables.Measured, ...]
    table3: tuple[tables.Group, ...]
    panels: tuple[tables.Decay, ...]
    models: tuple[tables.ModelRow, ...]


def write_paper(result: RunResult, folder: Path, out: Path, *, force: bool, progress: Progress) -> PaperPage:
    """Write OUT/paper.html for a finished run on `folder`.

    Parameters
    ----------
    force : bool
        Recompute the paper's numbers even if they are cached in OUT.

    Raises
    ------
    ModalcamError
        If OUT is in use by another process.
    """
    workspace = Workspace(out)
    with workspace.locked():
        progress.begin("recomputing the paper", 1)
        # A name that no recording has: theirs never begin with a dot.
        paper = recomputed(workspace.state(".paper", "recomputed"), force=force)
        progress.advance("paper")
        page = paper_page(result, paper, read_truth(folder))
        write_text(workspace.paper, paper_html(page))
    return page


def paper_page(result: RunResult, paper: Recomputed, truth: dict[int, TrueMode] | Failure) -> PaperPage:
    """Content of the page for one run."""
    modes = best_modes(result)
    table = tables.table_2(modes, truth)
    shown = tables.decays(result, {number: name for number, (name, _) in modes.items()})
    models = tables.model_rows(shown, paper)
    claims, lines = checks(table, models, paper), tables.table_3(paper, result.beam)
    properties = tables.table_1(paper, result.beam)
    return PaperPage(result, paper, truth, claims, properties, table, lines, shown, models)


def paper_html(page: PaperPage) -> str:
    """One HTML page: no script, nothing to load, the same bytes for the same content."""
    result, paper = page.result, page.paper
    beam = result.beam if result.beam is not None and result.beam.updated is not None else None
    measured = [row for row in page.table2 if row.recording]
    updates = [paper.optimum.reached, *([beam.updated.paper] if beam and beam.updated else [])]
    return (
        templates()
        .get_template("paper.html.j2")
        .render(
            css=style_sheet(),
            page=page,
            beam=beam,
            measured=measured,
            truth_known=any(np.isfinite(row.frequency.truth) for row in page.table2),
            gravity=tables.gravity_of(beam) if beam else "",
            differences=beam_differences(beam.standard) if beam else (),
            variables=[variables(update) for update in updates],
            damping=damping_ratios(result, measured, page.panels, paper),
            envelopes=envelopes(page.panels) if page.panels else "",
            decay_figures=decay_figures(page.panels),
            decay_errors=tables.model_errors(page.models),
            findings=findings(result),
            **numbers_of(paper),
        )
    )


def show(page: PaperPage, console: Console) -> None:
    """Print Tables 2 and 3 with the paper's values, and the checks."""
    console.print(_identified(page))
    console.print(_frequencies(page))
    for check in page.checks:
        line = Text(f"{check.verdict}: ", style=_STYLES[check.state])
        line.append(f"{check.claim}. {check.finding}", style="default")
        console.print(line)


def _identified(page: PaperPage) -> Table:
    f, z = ("f / Hz: paper", "ours", "simulated"), ("ζ / %: paper", "ours", "90 % interval", "simulated")
    table = Table("mode", *f, *z, title="Table 2")
    for row in page.table2:
        cells = [str(row.number)]
        for q in (row.frequency, row.damping):
            cells += [fixed(q.printed, 2), with_sd(q.value, q.sd)]
            cells += [interval(*q.interval_90, q.sd)] if q is row.damping else []
            cells += [f"{q.truth:.6g}" if np.isfinite(q.truth) else ""]
        table.add_row(*(Text(cell) for cell in cells))
    return table


def _frequencies(page: PaperPage) -> Table:
    names = ["frequencies / Hz", "", *(f"mode {n}" for n in range(1, 6)), "largest error"]
    table = Table(*names, title="Table 3")
    for group in page.table3:
        for line in group.lines:
            frequencies = (fixed(float(f), 2 if line.is_printed else 3) for f in line.frequency_hz)
            worst = error(largest(line.error)).removeprefix("+")
            table.add_row(*(Text(cell) for cell in (line.label, line.source, *frequencies, worst)))
        table.add_section()
    return table


def numbers(page: PaperPage) -> dict[str, Any]:
    """Numbers of the page for JSON; unknown values are None."""
    found: dict[str, Any] = jsonable(
        {
            "folder": page.result.folder,
            "checks": [{"claim": c.claim, "finding": c.finding, "holds": c.holds} for c in page.checks],
            "table_2": [
                {
                    "mode": row.number,
                    "recording": row.recording,
                    "frequency_hz": _quantity(row.frequency),
                    "damping_ratio_percent": _quantity(row.damping),
                }
                for row in page.table2
            ],
            "table_3": [
                {
                    "group": group.title,
                    "line": line.label,
                    "source": line.source,
                    "frequency_hz": line.frequency_hz,
                    "relative_error": line.error,
                }
                for group in page.table3
                for line in group.lines
            ],
            "decays": [
                {
                    "panel": row.decay.panel,
                    "mode": row.number,
                    "recording": row.decay.recording.name,
                    "model": row.model.model,
                    "simulated_over_measured_damping": row.ratio,
                    "nrmse": row.model.nrmse,
                    "coverage_90": row.model.coverage,
                }
                for row in page.models
            ],
        }
    )
    return found


def _quantity(q: tables.Quantity) -> dict[str, Any]:
    values = {"paper": q.printed, "simulated": q.truth, "measured": q.value, "sd": q.sd}
    return values | {"interval_90": q.interval_90, "interval_99": q.interval_99}

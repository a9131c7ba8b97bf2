"""All tables and figures of the paper with those of a folder: one HTML file, the terminal and JSON.

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
from numpy.typing import ArrayLike
from rich.console import Console
from rich.table import Table
from rich.text import Text

from modalcam.apps.paper import figures, tables
from modalcam.apps.paper.recomputed import (
    HANDBOOK_DENSITY_KG_M3,
    Recomputed,
    TrueMode,
    beam_differences,
    read_truth,
    recomputed,
)
from modalcam.pipeline import Progress, RunResult, Workspace, write_text
from modalcam.report import best_modes
from modalcam.report.sections import findings
from modalcam.report.style import (
    MISSING,
    environment,
    fixed,
    inline,
    interval,
    listed,
    percent,
    significant,
    style_sheet,
    with_sd,
)
from modalcam.tables import jsonable
from sim import reference as printed
from tracker import Failure, FloatArray


def signed_percent(ratio: float, digits: int = 2) -> str:
    """``+0.62 %``: a relative difference to `digits` significant digits; a dash for NaN."""
    if np.isnan(ratio):
        return MISSING
    text = significant(100.0 * ratio, digits)
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
            variables=[figures.variables(update) for update in updates],
            damping=figures.damping_ratios(result, measured, page.panels, paper),
            envelopes=figures.envelopes(page.panels) if page.panels else "",
            decay_figures=figures.decay_figures(page.panels),
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

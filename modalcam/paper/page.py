"""The page: all tables and figures of the paper with those of a folder, in one HTML file, the terminal and JSON."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from modalcam.execution import Progress
from modalcam.paper import decays, figures, table1, table2, table3, text
from modalcam.paper.checks import Check, checks, numbers_of, templates
from modalcam.paper.recomputed import Recomputed, recomputed
from modalcam.paper.simulated_truth import Truth, beam_differences, read_truth
from modalcam.pipeline import RunResult
from modalcam.report.derived import best_modes
from modalcam.report.sections import findings
from modalcam.report.style import fixed, interval, style_sheet, with_sd
from modalcam.storage import Workspace, write_text

_STYLES = {"good": "green", "care": "yellow", "none": "dim"}


@dataclass(frozen=True)
class PaperPage:
    """Content of the page; numbers are formatted by the template."""

    result: RunResult
    paper: Recomputed
    truth: Truth
    checks: tuple[Check, ...]
    table1: tuple[table1.Column, ...]
    table2: tuple[table2.Row, ...]
    table3: tuple[table3.Group, ...]
    panels: tuple[decays.Decay, ...]
    models: tuple[decays.Row, ...]


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


def paper_page(result: RunResult, paper: Recomputed, truth: Truth) -> PaperPage:
    """Content of the page for one run."""
    modes = best_modes(result)
    table = table2.rows(modes, truth)
    shown = decays.decays(result, {number: name for number, (name, _) in modes.items()})
    models = decays.rows(shown, paper)
    claims, lines = checks(table, models, paper), table3.groups(paper, result.beam)
    properties = table1.columns(paper, result.beam)
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
            gravity=table3.gravity_of(beam) if beam else "",
            differences=beam_differences(beam.standard) if beam else (),
            variables=[figures.variables(update) for update in updates],
            damping=figures.damping_ratios(result, measured, page.panels, paper),
            envelopes=figures.envelopes(page.panels) if page.panels else "",
            decay_figures=figures.decay_figures(page.panels),
            decay_errors=decays.errors(page.models),
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
            largest = text.error(text.largest(line.error)).removeprefix("+")
            table.add_row(*(Text(cell) for cell in (line.label, line.source, *frequencies, largest)))
        table.add_section()
    return table


def numbers(page: PaperPage) -> dict[str, Any]:
    """Numbers of the page for JSON; unknown values are None."""
    return {
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
                "frequency_hz": [_finite(f) for f in line.frequency_hz],
                "relative_error": [_finite(e) for e in line.error],
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
                "simulated_over_measured_damping": _finite(row.ratio),
                "nrmse": _finite(row.model.nrmse),
                "coverage_90": _finite(row.model.coverage),
            }
            for row in page.models
        ],
    }


def _quantity(q: table2.Quantity) -> dict[str, Any]:
    values = {"paper": q.printed, "simulated": q.truth, "measured": q.value, "sd": q.sd}
    intervals = {"interval_90": q.interval_90, "interval_99": q.interval_99}
    return {name: _finite(value) for name, value in values.items()} | {
        name: [_finite(value) for value in interval] for name, interval in intervals.items()
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None

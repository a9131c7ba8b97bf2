"""The page: all tables and figures of the paper with those of a folder, in one HTML file, the terminal and JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from modalcam.execution.progress import Progress
from modalcam.paper import decays, figures, table1, table2, table3, text
from modalcam.paper.checks import Check, checks
from modalcam.paper.measured import Truth, beam_differences, read_truth, target_modes
from modalcam.paper.recomputed import HANDBOOK_DENSITY_KG_M3, Recomputed, recomputed
from modalcam.pipeline.results import RunResult
from modalcam.report.sections.comparison import findings
from modalcam.report.style.environment import environment, style_sheet
from modalcam.report.style.format import fixed, interval, with_sd
from modalcam.storage.atomic import write_text
from modalcam.storage.output_folder import Workspace
from sim.reference import paper_tables as printed

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
    modes = target_modes(result)
    table = table2.rows(modes, truth)
    shown = decays.decays(result, {number: name for number, (name, _) in modes.items()})
    models = decays.rows(shown, paper)
    return PaperPage(
        result=result,
        paper=paper,
        truth=truth,
        checks=checks(table, models, paper),
        table1=table1.columns(paper, result.beam),
        table2=table,
        table3=table3.groups(paper, result.beam),
        panels=shown,
        models=models,
    )


def paper_html(page: PaperPage) -> str:
    """One HTML page: no script, nothing to load, the same bytes for the same content."""
    env = environment(("modalcam.paper", "templates"))
    for text_filter in text.FILTERS:
        env.filters[text_filter.__name__] = text_filter
    result, paper = page.result, page.paper
    beam = result.beam if result.beam is not None and result.beam.updated is not None else None
    measured = [row for row in page.table2 if row.recording]
    return env.get_template("paper.html.j2").render(
        css=style_sheet(),
        page=page,
        paper=paper,
        beam=beam,
        printed=printed,
        handbook=HANDBOOK_DENSITY_KG_M3,
        labels=table1.LABELS,
        standard=np.array(printed.TABLE_3_STANDARD_HZ),
        optimum=np.array(printed.TABLE_3_OPTIMUM_HZ),
        test=np.array(printed.TABLE_3_TEST_HZ),
        measured=measured,
        agreements=[
            ("damping ratio", table2.agreement([(r.number, r.damping) for r in measured])),
            ("natural frequency", table2.agreement([(r.number, r.frequency) for r in measured])),
        ],
        simulated=table2.simulated(page.table2),
        truth_known=any(row.frequency.simulated for row in page.table2),
        gravity=table3.gravity_of(beam) if beam is not None else "",
        differences=beam_differences(beam.standard) if beam is not None else (),
        preferences=[
            table3.preference(updating.evidence) if updating is not None else None
            for updating in (paper.optimum.to_test, beam.updated if beam is not None else None)
        ],
        variables=figures.variables(paper, beam),
        damping=figures.damping_ratios(result, measured, page.panels, paper),
        envelopes=figures.envelopes(page.panels),
        decay_figures=decays.figures(page.panels),
        missing_decays=decays.missing(page.panels),
        decay_errors=decays.errors(page.models),
        findings=findings(result),
        notes=decays.notes(page.panels),
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
        for q, extra in (
            (row.frequency, []),
            (row.damping, [interval(*row.damping.interval_90, row.damping.sd)]),
        ):
            cells += [
                fixed(q.printed, 2),
                with_sd(q.value, q.sd),
                *extra,
                f"{q.truth:.6g}" if q.simulated else "",
            ]
        table.add_row(*(Text(cell) for cell in cells))
    return table


def _frequencies(page: PaperPage) -> Table:
    names = ["frequencies / Hz", "", *(f"mode {n}" for n in range(1, 6)), "largest error"]
    table = Table(*names, title="Table 3")
    for group in page.table3:
        for line in group.lines:
            frequencies = (fixed(float(f), 2 if line.is_printed else 3) for f in line.frequency_hz)
            cells = (line.label, line.source, *frequencies, text.error(line.largest).removeprefix("+"))
            table.add_row(*(Text(cell) for cell in cells))
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
                "frequency_hz": [_finite(float(f)) for f in line.frequency_hz],
                "relative_error": [_finite(float(e)) for e in line.error],
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
    return {
        "paper": q.printed,
        "simulated": _finite(q.truth),
        "measured": _finite(q.value),
        "sd": _finite(q.sd),
        "interval_90": [_finite(v) for v in q.interval_90],
        "interval_99": [_finite(v) for v in q.interval_99],
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None

"""The page: all tables and figures of the paper beside a folder's, in one HTML file."""

from __future__ import annotations

from dataclasses import dataclass

from modalcam.paper import decays, figures, table1, table2, table3
from modalcam.paper.checks import Check, checks
from modalcam.paper.errata import Erratum, errata
from modalcam.paper.recomputed import Recomputed
from modalcam.paper.recorded import target_modes
from modalcam.paper.truth import Truth
from modalcam.pipeline.results import BeamResult, RunResult
from modalcam.report.figures.damping import DampingPoint
from modalcam.report.style.environment import environment, style_sheet
from modalcam.report.style.svg import FigureView
from modalcam.report.style.text import sentence


@dataclass(frozen=True)
class PaperInput:
    """All that the page is made of."""

    result: RunResult
    paper: Recomputed
    truth: Truth


@dataclass(frozen=True)
class PaperPage:
    """The page's content as text and figures."""

    folder: str
    checks: tuple[Check, ...]
    table1: tuple[table1.Column, ...]
    table1_says: tuple[str, ...]
    variables: tuple[FigureView, ...]
    table2: tuple[table2.Row, ...]
    table2_says: tuple[str, ...]
    table3: tuple[table3.Group, ...]
    table3_says: tuple[str, ...]
    damping: FigureView | None
    envelopes: FigureView | None
    decay_figures: tuple[FigureView, ...]
    models: tuple[decays.Row, ...]
    models_say: tuple[str, ...]
    models_notes: tuple[str, ...]
    errata: tuple[Erratum, ...]
    not_done: tuple[str, ...]
    command_line: str
    seed: int
    versions: tuple[tuple[str, str], ...]

    @property
    def simulated(self) -> bool:
        """Whether the folder tells what its recordings were simulated with."""
        return any(q.truth == q.truth for row in self.table2 for q in (row.frequency, row.damping))


def paper_page(given: PaperInput) -> PaperPage:
    """Gather what the page shows."""
    result, paper, beam = given.result, given.paper, given.result.beam
    modes = target_modes(result)
    measured = table2.rows(modes, given.truth)
    shown = decays.decays(result, {number: name for number, (name, _) in modes.items()})
    models = decays.rows(shown, paper)
    return PaperPage(
        folder=result.folder,
        checks=checks(measured, models, paper),
        table1=table1.columns(paper, beam),
        table1_says=table1.sentences(paper, beam),
        variables=_variables(paper, beam),
        table2=measured,
        table2_says=table2.sentences(measured, given.truth),
        table3=table3.groups(paper, beam),
        table3_says=table3.sentences(paper, beam),
        damping=figures.damping_ratios(result, _points(measured), shown, paper),
        envelopes=figures.envelopes(shown),
        decay_figures=decays.figures(shown),
        models=models,
        models_say=decays.sentences(models, result, paper),
        models_notes=decays.notes(shown),
        errata=errata(paper),
        not_done=tuple(sentence(text) for text in result.not_done),
        command_line=result.command_line,
        seed=result.seed,
        versions=result.versions,
    )


def paper_html(page: PaperPage) -> str:
    """One HTML page with everything in it: no script, nothing to load, the same bytes for the same input."""
    template = environment(("modalcam.paper", ".")).get_template("paper.html.j2")
    return template.render(css=style_sheet(), page=page, cells=table2.cells, labels=table1.LABELS)


def _points(measured: tuple[table2.Row, ...]) -> list[DampingPoint]:
    return [
        DampingPoint(
            row.frequency.value,
            0.01 * row.damping.value,
            0.01 * row.damping.interval_90[0],
            0.01 * row.damping.interval_90[1],
            f"mode {row.number}",
        )
        for row in measured
        if row.recording
    ]


def _variables(paper: Recomputed, beam: BeamResult | None) -> tuple[FigureView, ...]:
    views = [
        figures.variables_figure(
            "paper-variables",
            paper.optimum.reached,
            title="The paper’s variables, for Table 3’s optimum column",
            aim="reach the printed optimum",
        )
    ]
    if beam is not None and beam.updated is not None:
        views.append(
            figures.variables_figure(
                "recorded-variables",
                beam.updated.paper,
                title="The paper’s variables, for these recordings",
                aim="reach the measured frequencies and shapes",
            )
        )
    return tuple(views)

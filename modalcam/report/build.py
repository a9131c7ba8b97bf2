"""The report's HTML from the result of a run, and its figures, drawn in the run's worker processes."""

from __future__ import annotations

import base64
import hashlib
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import jinja2

from modal_id import IdentifiedMode
from modalcam.pipeline import (
    Cache,
    Progress,
    RunResult,
    WorkerPool,
    aliases,
    budgets,
    compared,
    measured_modes,
    model_scores,
)
from modalcam.report.figures import (
    FIGURES,
    RECORDING_PLACES,
    RUN_PLACES,
    FigureKind,
    RecordingSubject,
    figures_of,
    shown_in,
)
from modalcam.report.sections import (
    MOST_PLACES,
    PASSED,
    SECTIONS,
    TUNING,
    added_sections,
    alerts,
    detail_for,
    findings,
    flag_meanings,
    recording_view,
    updating_numbers,
    updating_rows,
    worst_ratios,
)
from modalcam.report.signals import widest_and_narrowest
from modalcam.report.style import environment, hertz, style_sheet, trusted, unbroken
from sim.beam import BeamModes

Plots = Literal["interactive", "static"]


def build_report(
    result: RunResult,
    cache: Cache | None = None,
    plots: Plots | None = None,
    contents: Sequence[tuple[str, str]] = (),
) -> str:
    """One HTML page with everything in it: nothing to load, the same bytes for the same input.

    Parameters
    ----------
    result : RunResult
        Of any number of recordings, none included, each through as many stages as it reached.
    cache : Cache or None
        Where figures are kept, each under the hash of what it shows; None draws all.
    plots : {"interactive", "static"} or None
        Whether the page has a script that zooms its figures, which are there without it, too. None: where all figures
        are drawn, which is up to 12 recordings.
    contents : sequence of (str, str)
        Path of each other file beside the page, relative to it, and what it holds.
    """
    detail = detail_for(len(result.recordings))
    beam = result.beam
    theory = _theory(result)
    identified = [found for r in result.recordings if (found := r.identified) is not None]
    good = [found for found in identified if found.modes]
    driven = [found for found in identified if found.driven]
    views = [recording_view(i, r, theory, detail, cache) for i, r in enumerate(result.recordings)]
    across = [mode for mode in measured_modes(result.recordings) if len(mode.recordings) > 1]
    main = [mode for view in views for mode in view["main"]]
    pictured = widest_and_narrowest(result)
    numbers = {} if beam is None else updating_numbers(beam)
    checks = alerts(result, views, across, numbers)
    explained = {alert.name for alert in checks if alert.meaning and not alert.remedy}
    zooms = detail.diagnostics if plots is None else plots == "interactive"
    script = trusted(_script()) if zooms else ""
    page: dict[str, Any] = {
        "css": style_sheet(),
        "script": script,
        "script_hash": base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        "result": result,
        "recordings": views,
        "good": good,
        "driven": driven,
        "main_modes": main,
        "amplitude_dependent": any("AMPLITUDE_DEPENDENT" in mode.flags for mode in main),
        "clock_exact": bool(main) and not any(mode.posterior.rate_sd_ppm for mode in main),
        "beyond_clock": any("†" in _frequency(mode) for mode in main),
        "alerts": checks,
        "failed": [alert for alert in checks if alert.kind not in PASSED],
        "passed": PASSED,
        "without_rate": sum(len(alert.places) for alert in checks if alert.kind == "playback"),
        "most_places": MOST_PLACES,
        "across": across,
        "aliases": aliases(result.recordings),
        "repeats_disagree": any(alert.kind == "repeats" for alert in checks),
        "budgets": budgets(result.recordings),
        "overview_figures": list(figures_of("overview", result, "all", cache=cache)),
        "pictured": [view for shown in pictured for view in views if view["recording"] is shown],
        "damping_figures": list(figures_of("damping", result, "all", cache=cache)),
        "comparison_figures": list(figures_of("comparison", result, "all", cache=cache)),
        "compared": compared(result.recordings),
        "worst": worst_ratios(result),
        "scores": model_scores(result.recordings),
        "findings": findings(result),
        "updating": updating_rows(result),
        "updating_numbers": numbers,
        "updating_figures": list(figures_of("updating", result, "all", cache=cache)),
        "readings": _readings(views),
        "detail": detail,
        "contents": contents,
        "terms": report_terms(),
        "flag_meanings": flag_meanings(),
        "explained": sorted(explained),
        "r_hat_limit": TUNING.r_hat,
        "sections": list(SECTIONS.values()),
        "run_sections": added_sections(result, cache),
    }
    return unbroken(_templates().get_template("report.html.j2").render(page))


def _frequency(mode: IdentifiedMode) -> str:
    return hertz(mode.frequency_hz, mode.frequency_sd_hz, clock_is_known=mode.posterior.rate_sd_ppm > 0.0)


def _templates() -> jinja2.Environment:
    """Templates of the report and of the sections that are added."""
    return environment(*dict.fromkeys((section.package, "templates") for section in SECTIONS.values()))


def compiled_templates() -> Iterator[str]:
    """Compile one template of the report after the other, which takes a third of a second for all."""
    templates = _templates()
    for name in templates.list_templates(filter_func=lambda name: name.endswith((".j2", ".css"))):
        templates.get_template(name)
        yield name


def shown_figures(result: RunResult) -> Iterator[tuple[FigureKind[Any], Any]]:
    """Every figure that the report of `result` has, each with what it shows; nothing is drawn."""
    detail, theory = detail_for(len(result.recordings)), _theory(result)
    for recording in result.recordings if detail.figures else ():
        subject = RecordingSubject(recording, theory, detail.strips)
        yield from shown_in(RECORDING_PLACES, subject, only_essential=not detail.diagnostics)
    yield from shown_in(RUN_PLACES, result)


def _theory(result: RunResult) -> BeamModes | None:
    """Modes of the beam to compare shapes with."""
    return None if result.beam is None else result.beam.updated_modes or result.beam.standard_modes


def _script() -> str:
    return resources.files("modalcam.report").joinpath("templates", "zoom.js").read_text("utf-8")


def _readings(views: Iterable[dict[str, Any]]) -> dict[str, tuple[str, str]]:
    """Title and text on how to read each kind of figure that the recordings have."""
    figures = [figure for view in views for figure in (*view["figures"], *view["tracking_figures"])]
    return {figure.key: (figure.title, figure.reading) for figure in figures if figure.reading}


def report_terms() -> dict[str, dict[str, str]]:
    """Name and text of each term of the report's glossary and of docs/glossary.md."""
    return tomllib.loads(resources.files("modalcam.report").joinpath("glossary.toml").read_text("utf-8"))


@dataclass(frozen=True)
class _Task:
    kind: str
    shown: Any
    folder: Path
    key: str


def draw_figures(
    result: RunResult, folder: Path, pool: WorkerPool, progress: Progress, meanwhile: Iterator[object]
) -> None:
    """Draw the figures of the report of `result` that `folder`, where they are kept, does not hold.

    This process takes steps of `meanwhile` until they are drawn.
    """
    kept = Cache(folder)
    tasks: dict[str, _Task] = {}
    for kind, shown in shown_figures(result):
        key = kind.cache_key(shown)
        if not kept.holds(key):
            tasks[key] = _Task(kind.key, shown, folder, key)
    if not tasks:
        return
    names = [task.kind for task in tasks.values()]
    progress.begin("drawing", len(names))
    pool.map(
        _draw,
        list(tasks.values()),
        done=lambda at: progress.advance(names[at]),
        meanwhile=meanwhile,
        unit="figure",
    )


def _draw(task: _Task) -> None:
    kind = FIGURES.get(task.kind)
    # What a worker would draw otherwise, such as with another matplotlib, is left to the process that asks for it.
    if kind is not None and kind.cache_key(task.shown) == task.key:
        kind.svg(task.shown, Cache(task.folder))

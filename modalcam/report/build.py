"""The report's HTML from the result of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from modal_id.results import Identification
from modalcam.pipeline.results import BeamResult, RunResult
from modalcam.report.sections import methods
from modalcam.report.sections.across import across_rows
from modalcam.report.sections.alerts import Alert, alerts
from modalcam.report.sections.beam import BeamView, beam_view
from modalcam.report.sections.detail import detail_for
from modalcam.report.sections.glossary import TERMS, frame_flag_terms, mode_flag_terms
from modalcam.report.sections.modes import headline, mode_rows
from modalcam.report.sections.recording import recording_view
from modalcam.report.style.environment import environment, style_sheet
from modalcam.report.style.text import prose, sentence
from modalcam.storage.cache import Cache
from sim.beam.modes import BeamModes


@dataclass(frozen=True)
class MethodsView:
    """Paragraphs (title, text) and the numbered sources of the methods text."""

    paragraphs: tuple[tuple[str, str], ...]
    sources: tuple[methods.Reference, ...]


def build_report(result: RunResult, cache: Cache | None = None) -> str:
    """One HTML page with everything in it: no script, nothing to load, the same bytes for the same input.

    Parameters
    ----------
    result : RunResult
        Of any number of recordings, none included, each through as many stages as it reached.
    """
    detail = detail_for(len(result.recordings))
    theory = None if result.beam is None else _best_modes(result.beam)
    simulation: BeamView = beam_view(result, cache)
    not_done = (*result.not_done, *((detail.note,) if detail.note else ()))
    raised: tuple[Alert, ...] = alerts(result)
    page: dict[str, Any] = {
        "result": result,
        "headline": headline(result),
        "alerts": raised,
        "modes": mode_rows(result),
        "across": across_rows(result),
        "simulation": simulation,
        "recordings": tuple(
            recording_view(i, r, theory, detail, cache) for i, r in enumerate(result.recordings)
        ),
        "not_done": tuple(sentence(text) for text in not_done),
        "config_lines": tuple(prose(line) for line in result.resolved_config.splitlines()),
        "methods": _methods(result),
        "terms": TERMS,
        "mode_flags": mode_flag_terms(),
        "frame_flags": frame_flag_terms(),
        "raised_flags": _raised_flags(result),
    }
    return environment().get_template("report.html.j2").render(css=style_sheet(), **page)


def _best_modes(beam: BeamResult) -> BeamModes:
    return beam.standard_modes if beam.updated_modes is None else beam.updated_modes


def _methods(result: RunResult) -> MethodsView:
    parts = methods.paragraphs(simulated=result.beam is not None)
    sources = methods.cited(parts)
    return MethodsView(tuple((p.title, methods.numbered(p.text, sources)) for p in parts), sources)


def _raised_flags(result: RunResult) -> tuple[str, ...]:
    raised: dict[str, None] = {}
    for recording in result.recordings:
        if isinstance(recording.identification, Identification):
            for mode in recording.identification.modes:
                raised.update(dict.fromkeys(mode.flags))
    return tuple(raised)

"""The report's HTML from the result of a run."""

from __future__ import annotations

from typing import Any

from modal_id.results import Identification
from modalcam.pipeline.results import RunResult
from modalcam.pipeline.scoreboard import model_scores
from modalcam.report.figures.registry import figures_of
from modalcam.report.sections.alerts import R_HAT_LIMIT, alerts
from modalcam.report.sections.comparison import comparison_rows, findings, shift_rows, worst_ratios
from modalcam.report.sections.glossary import TERMS, frame_flag_terms, mode_flag_terms
from modalcam.report.sections.images import CLOSE_UP_SHOWN_PX, SHOWN_PER_S
from modalcam.report.sections.modes import across_rows, headline, mode_name, mode_rows
from modalcam.report.sections.recording import detail_for, recording_view
from modalcam.report.sections.updating import updating_numbers, updating_rows
from modalcam.report.style.environment import environment, style_sheet
from modalcam.storage.cache import Cache


def build_report(result: RunResult, cache: Cache | None = None) -> str:
    """One HTML page with everything in it: no script, nothing to load, the same bytes for the same input.

    Parameters
    ----------
    result : RunResult
        Of any number of recordings, none included, each through as many stages as it reached.
    cache : Cache or None
        Where figures are kept, each under the hash of what it shows; None draws all.
    """
    detail = detail_for(len(result.recordings))
    beam = result.beam
    theory = (
        None if beam is None else beam.standard_modes if beam.updated_modes is None else beam.updated_modes
    )
    comparison = comparison_rows(result)
    page: dict[str, Any] = {
        "result": result,
        "headline": headline(result),
        "alerts": alerts(result),
        "modes": mode_rows(result),
        "across": across_rows(result),
        "damping_figures": tuple(figures_of("damping", result, "all", cache=cache)),
        "comparison": comparison,
        "worst": worst_ratios(comparison),
        "scores": model_scores(result.recordings),
        "findings": findings(result),
        "shifts": shift_rows(result),
        "updating": updating_rows(result),
        "updating_numbers": {} if beam is None else updating_numbers(beam),
        "updating_figures": tuple(figures_of("updating", result, "all", cache=cache)),
        "recordings": tuple(
            recording_view(i, r, theory, detail, cache) for i, r in enumerate(result.recordings)
        ),
        "detail": detail,
        "terms": TERMS,
        "mode_flags": mode_flag_terms(),
        "frame_flags": frame_flag_terms(),
        "raised_flags": _raised_flags(result),
        "r_hat_limit": R_HAT_LIMIT,
    }
    templates = environment()
    templates.filters["mode_name"] = mode_name
    templates.globals.update(shown_per_s=SHOWN_PER_S, close_up_px=CLOSE_UP_SHOWN_PX)
    return templates.get_template("report.html.j2").render(css=style_sheet(), **page)


def _raised_flags(result: RunResult) -> set[str]:
    found = [r.identification for r in result.recordings if isinstance(r.identification, Identification)]
    return {flag for identification in found for mode in identification.modes for flag in mode.flags}

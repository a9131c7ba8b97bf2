"""A plan in the terminal and as one HTML page."""

from __future__ import annotations

from dataclasses import dataclass

import jinja2
from markupsafe import Markup
from rich.console import Console
from rich.table import Table

from modalcam.apps.plan.request import ModePlan, Plan, TrialSummary
from modalcam.report.style import environment, fixed, percent, significant, style_sheet

_CAVEAT = (
    "± is one standard deviation, as in the report of a run. It covers camera noise and, for frequencies, "
    "camera.fps_tolerance_ppm. Light flicker, compression, camera vibration, air, and amplitude-dependent damping "
    "increase it; below 0.6 % of a damping ratio they usually dominate."
)
_HEADINGS = ("mode", "frequency (Hz)", "damping ratio (%)", "relative", "largest motion", "limited by")


@dataclass(frozen=True)
class Tuning:
    """Limits of the advice."""

    #: [px] a smaller motion is lost in flicker of the light and vibration of the camera
    #: convention: Chosen: what an ordinary recording separates from them.
    least_motion: float = 0.05
    #: [cycles] fewer are too few to find the onset of the decay
    cycles: int = 5
    #: [cycles] distance of the apparent frequency from 0 and half the rate, over the record
    #: convention: Ten lines of the spectrum of the record.
    apart: int = 10
    #: [px] motion during an exposure up to which markers are detected and tracked
    #: convention: Chosen: about what detection and tracking take.
    blur: int = 10
    #: [cycles] a longer exposure averages most of the motion out
    #: physics: A sine is attenuated by sin(pi x) / (pi x): 0.64 at 0.5.
    exposed: float = 0.5


TUNING = Tuning()


def show(plan: Plan, console: Console) -> None:
    """Print the predicted standard deviations and the advice."""
    table = Table(title="Predicted standard deviations")
    for column in (*_HEADINGS, *(["trials"] if plan.trials else [])):
        table.add_column(column)
    for row in _rows(plan):
        table.add_row(*row)
    console.print(table)
    console.print(_CAVEAT, style="dim", highlight=False)
    for text in (*advice(plan), *(f"Assumed: {text}" for text in plan.request.assumptions)):
        console.print(f"- {text}", markup=False, highlight=False)


def advice(plan: Plan) -> tuple[str, ...]:
    """All warnings, then suggestions, as sentences in plain text."""
    text = _template("advice.txt.j2").render(plan=plan, tuning=TUNING)
    return tuple(line for line in Markup(text).unescape().splitlines() if line)  # noqa: S704 - becomes plain text


def plan_html(plan: Plan) -> str:
    """One HTML page: no script, nothing to load, the same bytes for the same plan."""
    return _template("plan.html.j2").render(
        css=style_sheet(),
        plan=plan,
        headings=_HEADINGS,
        rows=_rows(plan),
        caveat=_CAVEAT,
        advice=advice(plan),
    )


def _template(name: str) -> jinja2.Template:
    return environment(("modalcam.apps.plan", "templates")).get_template(name)


def _rows(plan: Plan) -> list[tuple[str, ...]]:
    trials = {t.mode: t for t in plan.trials}
    return [(*_cells(m), *([_trials(m, trials[m.number])] if m.number in trials else [])) for m in plan.modes]


def _cells(mode: ModePlan) -> tuple[str, ...]:
    first = mode.limits[0]
    return (
        str(mode.number),
        f"{mode.frequency_hz:.5g} ± {significant(mode.frequency_sd_hz, 2)}",
        f"{100.0 * mode.damping_ratio:.4g} ± {significant(100.0 * mode.damping_sd, 2)}",
        f"± {percent(mode.damping_sd / mode.damping_ratio)}",
        f"{significant(mode.largest_px)} px, {significant(mode.decay_s)} s",
        first.cause + (f" (× {first.factor:.2g})" if first.factor > 1.0 else ""),
    )


def _trials(mode: ModePlan, trials: TrialSummary) -> str:
    share = f"{trials.identified} of {trials.count} identified"
    if trials.identified < 3:
        return share
    spread = significant(100.0 * trials.damping_spread, 2)
    return f"± {spread} % ({fixed(trials.damping_spread / mode.damping_sd, 2)} of predicted), {share}"

"""A plan for people: a table in the terminal, and one HTML page."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import resources

import jinja2
from rich.console import Console
from rich.table import Table

from modalcam.planning.predict import ModePlan
from modalcam.planning.request import PlanRequest
from modalcam.planning.suggest import Places, Rate
from modalcam.planning.tried import Tried
from modalcam.report.style.format import significant

# Quantile of the normal distribution: 90 % lie within so many standard deviations.
_NINETY = 1.645


CAVEAT = (
    "What the camera's noise alone leaves open. Lamps, compression, a camera that shakes, air, and damping that "
    "depends on amplitude make real intervals wider; below 1 % of a damping ratio they usually decide."
)


@dataclass(frozen=True)
class Plan:
    """A prediction with what was suggested and, where it was tried out, what that showed."""

    request: PlanRequest
    modes: tuple[ModePlan, ...]
    places: Places | None
    rates: tuple[Rate, ...]
    tried: tuple[Tried, ...] = ()


@dataclass(frozen=True)
class Row:
    """One line of the table, as text."""

    mode: int
    frequency: str
    damping: str
    motion: str
    limit: str
    tried: str


def rows(plan: Plan) -> tuple[Row, ...]:
    """A line a mode."""
    tried = {t.mode: t for t in plan.tried}
    return tuple(
        Row(
            m.number,
            f"{m.frequency_hz:.5g} ± {significant(_NINETY * m.frequency_sd_hz, 2)}",
            f"{100 * m.damping_ratio:.4g} ± {significant(100 * _NINETY * m.damping_sd, 2)} "
            f"({significant(100 * _NINETY * m.damping_sd / m.damping_ratio, 2)} % of it)",
            f"{max(abs(m.amplitude_px)):.3g} px for {m.decay_s:.3g} s",
            m.limits[0].cause + (f" (× {m.limits[0].factor:.2g})" if m.limits[0].factor > 1.0 else ""),
            _tried_text(m, tried[m.number]) if m.number in tried else "",
        )
        for m in plan.modes
    )


def _tried_text(mode: ModePlan, tried: Tried) -> str:
    share = f"{tried.identified} of {tried.asked}"
    if tried.identified < 3:
        return f"{share} identified"
    spread = significant(100 * _NINETY * tried.damping_spread, 2)
    return f"± {spread} over {share}, {tried.damping_spread / mode.damping_sd:.2f} times"


def advice(plan: Plan) -> tuple[str, ...]:
    """Warnings and suggestions as sentences."""
    out = [f"Mode {m.number}: {w}" for m in plan.modes for w in m.warnings]
    for m in plan.modes:
        named = [limit for limit in m.limits if limit.factor > 1.0]
        out += [
            f"Mode {m.number}: its intervals are {limit.factor:.2g} times as wide for this cause: {limit.cause}. What "
            f"would help: {limit.advice}."
            for limit in named[:1]
        ]
    out += _softening(plan)
    if plan.places is not None:
        where = ", ".join(f"{p:g}" for p in plan.places.positions_mm)
        factors = ", ".join(
            f"{f:.2g} (mode {m.number})" for f, m in zip(plan.places.factors, plan.modes, strict=True)
        )
        out.append(f"Markers at {where} mm would multiply the intervals by {factors}.")
    for rate in plan.rates:
        if rate.aliased:
            seen = ", ".join(f"{f:.4g}" for f in rate.seen_hz)
            out.append(
                f"With a slower camera, {rate.fps:g} fps keeps all modes apart although some are aliased: they appear "
                f"at {seen} Hz."
            )
        else:
            enough = "would be enough" if rate.fps <= plan.request.fps else "or more is needed"
            out.append(
                f"{rate.fps:g} fps {enough} to sample every planned mode well above twice its frequency."
            )
    return tuple(out)


def _softening(plan: Plan) -> list[str]:
    """What large amplitudes do to modes whose frequency then depends on them by more than the noise hides."""
    seen = [m for m in plan.modes if math.isfinite(m.linear_tip_mm)]
    if not seen:
        return []
    changes = ", ".join(f"{significant(100.0 * m.softening, 2)} % (mode {m.number})" for m in seen)
    below = ", ".join(f"{significant(m.linear_tip_mm, 2)} mm (mode {m.number})" for m in seen)
    told = (
        f"At these amplitudes frequencies are off those of small motion by {changes}, more than the noise: run will "
        "say that they depend on the amplitude, and give intervals several times as wide as these. Tip amplitudes up "
        f"to {below} stay within the noise, which then weighs more against the motion."
    )
    return [told]


def show(plan: Plan, console: Console) -> None:
    """Print the table and the advice."""
    table = Table(title="Predicted 90 % intervals")
    columns = ["mode", "frequency / Hz", "damping ratio / %", "largest motion", "limited by"]
    columns += ["tried out"] if plan.tried else []
    for column in columns:
        table.add_column(column)
    for row in rows(plan):
        cells = [str(row.mode), row.frequency, row.damping, row.motion, row.limit]
        table.add_row(*cells, *([row.tried] if plan.tried else []))
    console.print(table)
    console.print(CAVEAT, style="dim", highlight=False)
    for text in advice(plan):
        console.print(f"- {text}", markup=False, highlight=False)


def plan_html(plan: Plan) -> str:
    """One HTML page: no script, nothing to load."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("modalcam.planning", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
    )
    css = resources.files("modalcam.report").joinpath("templates", "style.css").read_text(encoding="utf-8")
    camera, beam = plan.request.camera, plan.request.beam
    section = f"{1e3 * beam.width_m.mean():g} × {1e3 * beam.thickness_m.mean():g} mm"
    facts = (
        ("Beam", f"{1e3 * beam.length_m:g} × {section}, {beam.orientation}"),
        ("Frame rate", f"{plan.request.fps:g} fps"),
        ("Exposure", f"{1e3 * camera.exposure_s:.3g} ms" if camera.exposure_s else "taken as an instant"),
        ("Scale", f"{camera.mm_per_px:g} mm per px"),
        (
            "Noise",
            f"{camera.read_noise_sd:g} counts and {camera.noise_gain:g} counts per electron, {camera.bit_depth} bit",
        ),
        ("Lens blur", f"{camera.lens_blur_px:g} px"),
        ("Markers at", ", ".join(f"{p:g}" for p in plan.request.positions_mm) + " mm"),
        (
            "Amplitude of the tip",
            ", ".join(f"{m.tip_amplitude_mm:.3g} mm (mode {m.number})" for m in plan.request.modes),
        ),
    )
    return environment.get_template("plan.html.j2").render(
        css=css,
        rows=rows(plan),
        caveat=CAVEAT,
        advice=advice(plan),
        facts=facts,
        tried=bool(plan.tried),
        plan=plan,
    )

"""Table 1: properties of the beam, the paper's two rows and the answers that the same frequencies have here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from modalcam.paper.bounds import spread_over_starts
from modalcam.paper.recomputed import Recomputed
from modalcam.paper.words import signed_percent
from modalcam.pipeline.results import BeamResult
from modalcam.report.style.format import MISSING, fixed, percent, significant, with_sd
from sim.beam.properties import BeamProperties
from sim.reference import paper_tables as printed
from sim.updating import BayesianUpdate, PaperUpdate
from tracker.arrays import FloatArray

LABELS = (
    "Length (mm)",
    "Width (mm)",
    "Thickness (mm)",
    "Density (kg/m³)",
    "Elastic modulus (MPa)",
    "E h² / ρ against standard",
    "Variables at a bound",
)


@dataclass(frozen=True)
class Column:
    """One answer; `cells` has a value and a small remark for each of `LABELS`."""

    label: str
    source: str
    cells: tuple[tuple[str, str], ...]


def columns(paper: Recomputed, beam: BeamResult | None) -> tuple[Column, ...]:
    """The printed columns, the paper's variables aimed at its own optimum, and this folder's answers."""
    standard = printed.TABLE_1_STANDARD.beam("hanging")
    out = [
        _column("Paper, standard", "printed", standard, standard, (MISSING, "")),
        _column(
            "Paper, optimum",
            f"printed; limit {percent(printed.VARIABLE_BOUND)}",
            printed.TABLE_1_OPTIMUM.beam("hanging"),
            standard,
            ("not told", ""),
        ),
        _like_paper(
            "Ours, the paper’s variables",
            "no gravity, for Table 3’s optimum",
            paper.optimum.reached,
            standard,
        ),
    ]
    if beam is None or beam.updated is None:
        return tuple(out)
    standard, updated = beam.standard, beam.updated
    gravity = "no gravity" if standard.orientation == "none" else standard.orientation
    out += [
        _like_paper("Recordings, the paper’s variables", "no gravity", updated.paper, standard),
        _column(
            "Recordings, uniform",
            f"{gravity}, one factor on the thickness",
            updated.uniform.properties,
            standard,
            (MISSING, ""),
        ),
        _bayesian(f"{gravity}, posterior mean ± sd", updated.bayesian, standard),
    ]
    return tuple(out)


def _like_paper(label: str, source: str, update: PaperUpdate, standard: BeamProperties) -> Column:
    count = (f"{len(update.at_bound)} of {update.start_spread.size}", f"bound {percent(update.bound)}")
    return _column(label, source, update.properties, standard, count)


def _bayesian(source: str, update: BayesianUpdate, standard: BeamProperties) -> Column:
    """Means over the draws with standard deviations; the range over the elements is that of their means."""
    factor, ne = np.exp(update.log_factor_draws), standard.elements
    width = 1e3 * standard.width_m * factor[:, :ne]
    thickness = 1e3 * standard.thickness_m * factor[:, ne : 2 * ne]
    density = standard.density_kg_m3 * factor[:, -2]
    modulus = 1e-6 * standard.elastic_modulus_pa * factor[:, -1]
    stiffness = modulus * np.mean(thickness, axis=1) ** 2 / density
    own = (
        1e-6
        * standard.elastic_modulus_pa
        * (1e3 * np.mean(standard.thickness_m)) ** 2
        / standard.density_kg_m3
    )
    return Column(
        "Recordings, Bayesian",
        source,
        (
            (significant(1e3 * standard.length_m, 4), ""),
            _drawn_field(width, 2),
            _drawn_field(thickness, 4),
            (_drawn(density), ""),
            (_drawn(modulus), ""),
            (_drawn(stiffness / own), ""),
            (MISSING, "no bounds"),
        ),
    )


def _drawn(values: FloatArray) -> str:
    return with_sd(float(np.mean(values)), float(np.std(values)))


def _drawn_field(values: FloatArray, decimals: int) -> tuple[str, str]:
    each = np.mean(values, axis=0)
    ends = f"{fixed(float(each.min()), decimals)} to {fixed(float(each.max()), decimals)}"
    return f"mean {_drawn(np.mean(values, axis=1))}", ends


def _column(
    label: str, source: str, beam: BeamProperties, standard: BeamProperties, at_bound: tuple[str, str]
) -> Column:
    def changed(of: Callable[[BeamProperties], float]) -> str:
        ratio = of(beam) / of(standard) - 1.0
        return "" if abs(ratio) < 1e-9 else signed_percent(ratio)

    return Column(
        label,
        source,
        (
            (significant(1e3 * beam.length_m, 4), changed(lambda b: b.length_m)),
            _field(1e3 * beam.width_m, 1e3 * standard.width_m, 2),
            _field(1e3 * beam.thickness_m, 1e3 * standard.thickness_m, 4),
            (fixed(beam.density_kg_m3, 0), changed(lambda b: b.density_kg_m3)),
            (fixed(1e-6 * beam.elastic_modulus_pa, 0), changed(lambda b: b.elastic_modulus_pa)),
            (fixed(_stiffness(beam) / _stiffness(standard), 3), ""),
            at_bound,
        ),
    )


def _field(values: FloatArray, standard: FloatArray, decimals: int) -> tuple[str, str]:
    """Mean and, where the elements differ, the smallest and the largest; else the change."""
    mean, low, high = float(np.mean(values)), float(values.min()), float(values.max())
    if high / low - 1.0 > 1e-9:
        return f"mean {fixed(mean, decimals)}", f"{fixed(low, decimals)} to {fixed(high, decimals)}"
    ratio = mean / float(np.mean(standard)) - 1.0
    return fixed(mean, decimals), "" if abs(ratio) < 1e-9 else signed_percent(ratio)


def _stiffness(beam: BeamProperties) -> float:
    """Mean E h^2 / rho: all that the frequencies of a uniform beam tell without gravity, length aside."""
    return beam.elastic_modulus_pa * float(np.mean(beam.thickness_m)) ** 2 / beam.density_kg_m3


def sentences(paper: Recomputed, beam: BeamResult | None) -> tuple[str, ...]:
    """Why the columns differ, from their numbers."""
    reached = paper.optimum.reached
    frequencies = reached.mode_numbers.size
    out = [
        (
            f"{reached.start_spread.size} variables meet {frequencies} frequencies, so that at least "
            f"{reached.start_spread.size - frequencies} combinations of them are left open: the columns need "
            f"not agree, and none of them is a measurement of the beam. {spread_over_starts(reached)}"
        ),
        f"Ours is the answer nearest to the standard beam. Its mean thickness is {_against(reached)}.",
    ]
    if beam is not None and beam.updated is not None:
        u = beam.updated.uniform
        out.append(
            "The frequencies of a uniform beam tell E h² / ρ (its length and gravity known), and nothing of "
            f"E, h and ρ apart: these recordings’ best uniform beam has it at {fixed(u.stiffness_factor, 4)} "
            f"times that of the beam as configured, and leaves up to {percent(u.largest_error)} in a frequency."
        )
    return tuple(out)


def _against(reached: PaperUpdate) -> str:
    """Mean changes of ours beside the paper's."""
    s, o, b = printed.TABLE_1_STANDARD, printed.TABLE_1_OPTIMUM, reached.properties
    pairs = (
        ("thickness", 1e3 * float(np.mean(b.thickness_m)) / s.thickness_mm, o.thickness_mm / s.thickness_mm),
        ("density", b.density_kg_m3 / s.density_kg_m3, o.density_kg_m3 / s.density_kg_m3),
        (
            "modulus",
            1e-6 * b.elastic_modulus_pa / s.elastic_modulus_mpa,
            o.elastic_modulus_mpa / s.elastic_modulus_mpa,
        ),
    )
    texts = [
        f"{signed_percent(ours - 1.0)} where the paper has {signed_percent(theirs - 1.0)}"
        for _, ours, theirs in pairs
    ]
    return f"{texts[0]}, its density {texts[1]}, its modulus {texts[2]}"

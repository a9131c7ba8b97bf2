"""Table 1: properties of the beam, the paper's two rows and the answers from the same frequencies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modalcam.paper.recomputed import Recomputed
from modalcam.paper.text import signed_percent
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
    "E h² / ρ relative to standard",
    "Variables at a bound",
)
# Of each property; None shows four significant digits.
_DECIMALS = (None, 2, 4, 0, 0, 3)


@dataclass(frozen=True)
class Column:
    """One answer; `cells` has a value and a remark for each of `LABELS`."""

    label: str
    source: str
    cells: tuple[tuple[str, str], ...]


def columns(paper: Recomputed, beam: BeamResult | None) -> tuple[Column, ...]:
    """The printed columns, the paper's variables fitted to its optimum column, and the answers from this folder."""
    standard = printed.TABLE_1_STANDARD.beam("hanging")
    out = [
        _column("Paper, standard", "printed", standard, standard, MISSING),
        _column(
            "Paper, optimum",
            f"printed; limit {percent(printed.VARIABLE_BOUND)}",
            printed.TABLE_1_OPTIMUM.beam("hanging"),
            standard,
            "not stated",
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
    return (
        *out,
        _like_paper("Recordings, the paper’s variables", "no gravity", updated.paper, standard),
        _column(
            "Recordings, uniform",
            f"{gravity}, one factor on the thickness",
            updated.uniform.properties,
            standard,
            MISSING,
        ),
        Column(
            "Recordings, Bayesian",
            f"{gravity}, posterior mean ± sd",
            (*_cells(_drawn(updated.bayesian, standard), _properties(standard)), (MISSING, "no bounds")),
        ),
    )


def _column(
    label: str, source: str, beam: BeamProperties, standard: BeamProperties, at_bound: str, remark: str = ""
) -> Column:
    return Column(label, source, (*_cells(_properties(beam), _properties(standard)), (at_bound, remark)))


def _like_paper(label: str, source: str, update: PaperUpdate, standard: BeamProperties) -> Column:
    share = f"{len(update.at_bound)} of {update.start_spread.size}"
    return _column(label, source, update.properties, standard, share, f"bound {percent(update.bound)}")


def _properties(beam: BeamProperties) -> list[FloatArray]:
    """Properties as in `LABELS`, each of shape (1, elements) or (1, 1)."""
    return _with_stiffness(
        np.array([[1e3 * beam.length_m]]),
        1e3 * beam.width_m[None],
        1e3 * beam.thickness_m[None],
        np.array([[beam.density_kg_m3]]),
        np.array([[1e-6 * beam.elastic_modulus_pa]]),
    )


def _drawn(update: BayesianUpdate, standard: BeamProperties) -> list[FloatArray]:
    """Properties of the draws from the posterior, each of shape (draws, elements) or (draws, 1)."""
    factor, ne = np.exp(update.log_factor_draws), standard.elements
    return _with_stiffness(
        np.full((factor.shape[0], 1), 1e3 * standard.length_m),
        1e3 * standard.width_m * factor[:, :ne],
        1e3 * standard.thickness_m * factor[:, ne : 2 * ne],
        standard.density_kg_m3 * factor[:, -2:-1],
        1e-6 * standard.elastic_modulus_pa * factor[:, -1:],
    )


def _with_stiffness(
    length: FloatArray, width: FloatArray, thickness: FloatArray, density: FloatArray, modulus: FloatArray
) -> list[FloatArray]:
    # Mean E h^2 / rho: without gravity, and for a given length, all that the frequencies of a uniform beam determine.
    stiffness = modulus * np.mean(thickness, axis=1, keepdims=True) ** 2 / density
    return [length, width, thickness, density, modulus, stiffness]


def _cells(values: list[FloatArray], standard: list[FloatArray]) -> list[tuple[str, str]]:
    relative = [*values[:-1], values[-1] / standard[-1]]
    return [
        _cell(value, reference, decimals)
        for value, reference, decimals in zip(relative, [*standard[:-1], None], _DECIMALS, strict=True)
    ]


def _cell(values: FloatArray, standard: FloatArray | None, decimals: int | None) -> tuple[str, str]:
    """Mean, with its standard deviation over draws; range over the elements where they differ, else the change."""
    means, each = values.mean(axis=1), values.mean(axis=0)
    mean = float(means.mean())
    text = significant(mean, 4) if decimals is None else fixed(mean, decimals)
    if values.shape[0] > 1:
        text = with_sd(mean, float(means.std()))
    if each.max() / each.min() - 1.0 > 1e-9:
        digits = decimals or 0
        return f"mean {text}", f"{fixed(float(each.min()), digits)} to {fixed(float(each.max()), digits)}"
    change = 0.0 if standard is None or values.shape[0] > 1 else mean / float(standard.mean()) - 1.0
    return text, "" if abs(change) < 1e-9 else signed_percent(change)

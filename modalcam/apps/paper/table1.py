"""Table 1: properties of the beam, the paper's two rows and the answers from the same frequencies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from modalcam.apps.paper.recomputed import Recomputed
from modalcam.pipeline import BeamResult
from modalcam.report.style import MISSING, percent
from sim import reference as printed
from sim.beam import BeamProperties
from sim.updating import BayesianUpdate, PaperUpdate
from tracker import FloatArray


class Column(NamedTuple):
    """One answer, and the standard beam to which it is compared.

    `values` and `standard` are length, width and thickness in mm, density in kg/m³, modulus in MPa and E h² / ρ, each
    of shape (draws or 1, elements or 1); `at_bound` counts the variables at their bound, with `remark` in small print.
    """

    label: str
    source: str
    values: list[FloatArray]
    standard: list[FloatArray]
    at_bound: str = MISSING
    remark: str = ""


def columns(paper: Recomputed, beam: BeamResult | None) -> tuple[Column, ...]:
    """The printed columns, the paper's variables fitted to its optimum column, and the answers from this folder."""
    row = _properties(printed.TABLE_1_STANDARD.beam("hanging"))
    optimum = _properties(printed.TABLE_1_OPTIMUM.beam("hanging"))
    limit = f"printed; limit {percent(printed.VARIABLE_BOUND)}"
    aim = "no gravity, for Table 3’s optimum"
    out = [
        Column("Paper, standard", "printed", row, row),
        Column("Paper, optimum", limit, optimum, row, "not stated"),
        _like_paper("Ours, the paper’s variables", aim, paper.optimum.reached, row),
    ]
    if beam is not None and beam.updated is not None:
        updated, row = beam.updated, _properties(beam.standard)
        gravity = "no gravity" if beam.standard.orientation == "none" else beam.standard.orientation
        uniform, drawn = _properties(updated.uniform.properties), _drawn(updated.bayesian, beam.standard)
        out += [
            _like_paper("Recordings, the paper’s variables", "no gravity", updated.paper, row),
            Column("Recordings, uniform", f"{gravity}, one factor on the thickness", uniform, row),
            Column("Recordings, Bayesian", f"{gravity}, posterior mean ± sd", drawn, row, remark="no bounds"),
        ]
    return tuple(out)


def _like_paper(label: str, source: str, update: PaperUpdate, standard: list[FloatArray]) -> Column:
    share, bound = f"{len(update.at_bound)} of {update.start_spread.size}", f"bound {percent(update.bound)}"
    return Column(label, source, _properties(update.properties), standard, share, bound)


def _properties(beam: BeamProperties) -> list[FloatArray]:
    return _with_stiffness(
        np.array([[1e3 * beam.length_m]]),
        1e3 * beam.width_m[None],
        1e3 * beam.thickness_m[None],
        np.array([[beam.density_kg_m3]]),
        np.array([[1e-6 * beam.elastic_modulus_pa]]),
    )


def _drawn(update: BayesianUpdate, standard: BeamProperties) -> list[FloatArray]:
    """Properties of the draws from the posterior."""
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

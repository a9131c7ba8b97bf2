"""The paper's tables recomputed from its own printed numbers, and the beam and simulated truth of a folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from modalcam.pipeline import TaskFailure, code_state, load, save, stage_key, worker_pool
from sim import reference as printed
from sim.beam import AncfBeam, BeamProperties, beam_modes
from sim.damping import RayleighDamping
from sim.updating import MeasuredModes, PaperUpdate, Updating, UpdatingSettings, update, update_like_paper
from tracker import Failure, FloatArray

# Handbook value for carbon steel: reproduces the printed frequencies, unlike the printed 8000.
HANDBOOK_DENSITY_KG_M3 = 7850.0
MODES = len(printed.TABLE_2_FREQUENCY_HZ)
# Determines a standard deviation to 4 %.
_DRAWS = 300


@dataclass(frozen=True)
class StandardColumn:
    """Table 3's standard column computed from Table 1's, shape (5,) each.

    Without gravity for the printed density and for `HANDBOOK_DENSITY_KG_M3`, and under gravity for the printed one.
    For `best_density_kg_m3` computed (without gravity) and printed frequencies have the same mean logarithm.
    """

    printed_density_hz: FloatArray
    handbook_density_hz: FloatArray
    best_density_kg_m3: float
    hanging_hz: FloatArray
    standing_hz: FloatArray


@dataclass(frozen=True)
class OptimumColumn:
    """Table 3's optimum column: a uniform beam with Table 1's optimum properties, without gravity and hanging.

    `reached` are the paper's variables fitted to the printed column, `to_test` all fits to the test column.
    """

    uniform_hz: FloatArray
    uniform_hanging_hz: FloatArray
    reached: PaperUpdate
    to_test: Updating


@dataclass(frozen=True)
class Equations:
    """The paper's equations in numbers, for its standard beam without gravity and Table 2.

    `alpha_1_s` and `beta_s` are by Eq. 4, `rayleigh_ratio` of each mode by Eq. 3 with these. The errors of Eq. 6 are
    ``|Phi^T C_g Phi - C_r| / |C_r|`` (Eq. 5; Frobenius) with C_g from its middle as printed and from its right side;
    `ratio_above` is the damping ratio that it gives the first mode above those of Table 2.
    """

    alpha_1_s: float
    beta_s: float
    rayleigh_ratio: FloatArray
    eq6_printed_error: float
    eq6_right_error: float
    ratio_above: float


@dataclass(frozen=True)
class Recomputed:
    """Everything that follows from the paper alone."""

    standard: StandardColumn
    optimum: OptimumColumn
    equations: Equations


def recompute(_: object = None) -> Recomputed:
    """Recompute the paper's tables from its printed numbers; the argument is that of a task of the worker pool."""
    return Recomputed(standard_column(), optimum_column(), equations())


def recomputed(saved: Path, *, force: bool = False) -> Recomputed:
    """`recompute`, or its result in the file `saved` if the same code has written it there.

    Raises
    ------
    RuntimeError
        If the computation, which has no input, fails: a bug.
    """
    key = stage_key("paper", code=code_state("sim", "modalcam.apps.paper.recomputed"))
    found = None if force else load(saved, key)
    if isinstance(found, Recomputed):
        return found
    # In a worker process linear algebra has one thread, and the same round-off everywhere.
    with worker_pool(1) as pool:
        value = pool.map(recompute, [None], unit="task")[0]
    if isinstance(value, TaskFailure):
        raise RuntimeError(value.reason)  # noqa: TRY004 - a failed computation, not a wrong type
    save(saved, key, value)
    return value


def _frequencies_hz(properties: BeamProperties) -> FloatArray:
    """Natural frequencies of the ANCF beam about its static equilibrium, shape (5,)."""
    return beam_modes(AncfBeam(properties), MODES).frequency_hz


def standard_column() -> StandardColumn:
    """Table 3's standard column from Table 1's."""
    row = printed.TABLE_1_STANDARD
    free = _frequencies_hz(row.beam("none"))
    # A frequency is inversely proportional to the root of the density.
    log_ratio = float(np.mean(np.log(free / np.array(printed.TABLE_3_STANDARD_HZ))))
    return StandardColumn(
        printed_density_hz=free,
        handbook_density_hz=_frequencies_hz(row.beam("none", density_kg_m3=HANDBOOK_DENSITY_KG_M3)),
        best_density_kg_m3=row.density_kg_m3 * float(np.exp(2.0 * log_ratio)),
        hanging_hz=_frequencies_hz(row.beam("hanging")),
        standing_hz=_frequencies_hz(row.beam("standing")),
    )


def optimum_column() -> OptimumColumn:
    """Table 3's optimum column from Table 1's, and from the paper's variables."""
    row, bound = printed.TABLE_1_OPTIMUM, printed.VARIABLE_BOUND
    standard = printed.TABLE_1_STANDARD.beam("hanging")
    settings = UpdatingSettings(bound=bound, draws=_DRAWS)
    to_test = update(standard, _printed_modes(printed.TABLE_3_TEST_HZ), settings)
    if isinstance(to_test, Failure):
        # The input is fixed: a failure is a bug.
        raise RuntimeError(to_test.reason)  # noqa: TRY004
    reached = update_like_paper(standard, _printed_modes(printed.TABLE_3_OPTIMUM_HZ), bound=bound)
    return OptimumColumn(
        _frequencies_hz(row.beam("none")), _frequencies_hz(row.beam("hanging")), reached, to_test
    )


def _printed_modes(frequency_hz: tuple[float, ...]) -> MeasuredModes:
    # The standard deviation of a value rounded to the last digit printed.
    sd_hz = np.full(MODES, 2.0 * printed.FREQUENCY_ROUNDING_HZ / np.sqrt(12.0))
    return MeasuredModes(np.arange(1, MODES + 1), np.array(frequency_hz), sd_hz)


def equations() -> Equations:
    """Eq. 4 from Table 2, and Eq. 6 substituted into Eq. 5."""
    omega = 2.0 * np.pi * np.array(printed.TABLE_2_FREQUENCY_HZ)
    ratio = printed.TABLE_2_DAMPING_RATIO
    rayleigh = RayleighDamping.from_modes((omega[0], omega[1]), (ratio[0], ratio[1]))
    return Equations(rayleigh.alpha_1_s, rayleigh.beta_s, rayleigh.damping_ratio(omega), *_eq6())


def _eq6() -> tuple[float, float, float]:
    """Errors of Eq. 6 as printed and of its right side against Eq. 5, and the damping of the first mode above."""
    beam = AncfBeam(printed.TABLE_1_STANDARD.beam("none"))
    # All bending modes of the mesh: across its axis, the beam has no other motion.
    modes = beam_modes(beam, 2 * beam.properties.elements)
    phi, mass, omega = modes.phi[1::2], beam.mass_matrix()[1::2, 1::2], modes.omega_rad_s
    damping = np.zeros(omega.size)
    damping[:MODES] = 2.0 * np.array(printed.TABLE_2_DAMPING_RATIO) * omega[:MODES]
    expected = np.diag(damping)
    as_printed = phi.T @ (phi.T @ expected @ phi.T) @ phi
    right = phi.T @ (mass @ phi @ expected @ phi.T @ mass) @ phi
    errors = [float(np.linalg.norm(c - expected) / np.linalg.norm(expected)) for c in (as_printed, right)]
    return errors[0], errors[1], float(right[MODES, MODES] / (2.0 * omega[MODES]))


TRUTH_NAME = "truth.json"


class TrueMode(NamedTuple):
    """Frequency at small amplitude and damping ratio with which a recording was simulated."""

    frequency_hz: float
    damping_ratio: float


def read_truth(folder: Path) -> dict[int, TrueMode] | Failure:
    """Simulated modes by number from `truth.json` in `folder`; empty if there is no such file."""
    try:
        entries = json.loads((folder / TRUTH_NAME).read_text("utf-8"))["recordings"]
        return {
            int(entry["mode"]): TrueMode(float(entry["frequency_hz"]), float(entry["damping_ratio"]))
            for entry in entries
        }
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError) as error:
        # The measurements are valid without it.
        return Failure(
            f"{TRUTH_NAME} was not used: expected a list of recordings, each with mode, frequency_hz and "
            f"damping_ratio; found {type(error).__name__}: {error}."
        )


def beam_differences(beam: BeamProperties) -> tuple[str, ...]:
    """Differences of a beam as configured from Table 1's standard column, which hangs."""
    row = printed.TABLE_1_STANDARD
    values = (
        ("length", 1e3 * beam.length_m, row.length_mm, "mm"),
        ("width", 1e3 * float(np.mean(beam.width_m)), row.width_mm, "mm"),
        ("thickness", 1e3 * float(np.mean(beam.thickness_m)), row.thickness_mm, "mm"),
        ("density", beam.density_kg_m3, row.density_kg_m3, "kg/m³"),
        ("modulus", 1e-6 * beam.elastic_modulus_pa, row.elastic_modulus_mpa, "MPa"),
    )
    out = [
        f"{name} {value:.6g} {unit} instead of {paper:.6g}"
        for name, value, paper, unit in values
        if abs(value / paper - 1.0) > 1e-6
    ]
    if beam.orientation != "hanging":
        out.append(f"{beam.orientation} instead of hanging")
    if beam.point_masses:
        out.append(f"{1e3 * sum(p.mass_kg for p in beam.point_masses):.3g} g of added mass")
    if beam.clamp is not None:
        out.append("an elastic clamp instead of a rigid one")
    return tuple(out)

"""What a run's recordings say to the paper's tables: measured modes, and three answers for the beam."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal_id.results import Identification, IdentifiedMode
from modalcam.beam_stage import known_modes
from modalcam.measured import MeasuredMode, measured_modes
from modalcam.paper.recomputed import frequencies_hz
from modalcam.run_result import BeamResult, RunResult
from sim import paper_tables as printed
from sim.beam import BeamProperties
from sim.updating import MeasuredModes, PaperUpdate, UniformUpdate, update_like_paper, update_uniform

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class BeamTask:
    """A beam as configured and the modes measured of it."""

    properties: BeamProperties
    measured: tuple[MeasuredMode, ...]


@dataclass(frozen=True)
class BeamAnswers:
    """Three answers to the same measured frequencies and shapes.

    Attributes
    ----------
    standard : BeamProperties
        As configured.
    measured : MeasuredModes
        Frequencies at small amplitude, which those of the beam are.
    standard_hz, free_hz : array, shape (m,)
        Of the beam as configured, under gravity and without.
    paper : PaperUpdate
        The paper's variables, without gravity.
    uniform : UniformUpdate
        One change everywhere, under gravity.
    """

    standard: BeamProperties
    measured: MeasuredModes
    standard_hz: FloatArray
    free_hz: FloatArray
    paper: PaperUpdate
    uniform: UniformUpdate


def target_modes(result: RunResult) -> dict[int, tuple[str, IdentifiedMode]]:
    """Recording and mode of each number: the target of its recording before one that rang along, then the best known."""
    best: dict[int, tuple[str, IdentifiedMode]] = {}
    for recording in result.recordings:
        found = recording.identification
        for mode in found.modes if isinstance(found, Identification) else ():
            if mode.number is None:
                continue
            held = best.get(mode.number)
            if held is None or _rank(mode) > _rank(held[1]):
                best[mode.number] = (recording.name, mode)
    return best


def _rank(mode: IdentifiedMode) -> tuple[bool, float]:
    return mode.target, -mode.frequency_sd_hz


def beam_task(result: RunResult) -> BeamTask | None:
    """What `answers` needs of a run, or None without a beam or a numbered mode."""
    beam: BeamResult | None = result.beam
    if beam is None:
        return None
    usable = known_modes(measured_modes(result.recordings), beam.standard_modes)
    return BeamTask(beam.standard, usable) if usable else None


def answers(task: BeamTask) -> BeamAnswers:
    """The paper's variables, a uniform change and the posterior, for one set of measured modes."""
    usable = task.measured
    measured = MeasuredModes(
        np.array([m.number for m in usable]),
        np.array([m.frequency_hz for m in usable]),
        np.array([m.frequency_sd_hz for m in usable]),
        tuple(m.shape for m in usable if m.shape is not None),
    )
    at = measured.mode_numbers - 1
    free = replace(task.properties, orientation="none", angle_deg=None)
    return BeamAnswers(
        standard=task.properties,
        measured=measured,
        standard_hz=frequencies_hz(task.properties, measured.highest)[at],
        free_hz=frequencies_hz(free, measured.highest)[at],
        paper=update_like_paper(task.properties, measured, bound=printed.VARIABLE_BOUND),
        uniform=update_uniform(task.properties, measured, bound=printed.VARIABLE_BOUND),
    )


def by_number(numbers: NDArray[np.int64], values: FloatArray, count: int) -> FloatArray:
    """Values of modes 1 to `count`, shape (count,); NaN for those that are not there."""
    out = np.full(count, np.nan)
    inside = numbers <= count
    out[numbers[inside] - 1] = values[inside]
    return out


def beam_differences(beam: BeamProperties) -> tuple[str, ...]:
    """How a beam as configured differs from Table 1's standard column, which hangs; nothing where it does not."""
    row = printed.TABLE_1_STANDARD
    values = (
        ("length", 1e3 * beam.length_m, row.length_mm, "mm"),
        ("width", 1e3 * float(np.mean(beam.width_m)), row.width_mm, "mm"),
        ("thickness", 1e3 * float(np.mean(beam.thickness_m)), row.thickness_mm, "mm"),
        ("density", beam.density_kg_m3, row.density_kg_m3, "kg/m³"),
        ("modulus", 1e-6 * beam.elastic_modulus_pa, row.elastic_modulus_mpa, "MPa"),
    )
    out = [
        f"{name} {value:.6g} {unit} against {paper:.6g}"
        for name, value, paper, unit in values
        if abs(value / paper - 1.0) > 1e-6
    ]
    if beam.orientation != "hanging":
        out.append(f"{beam.orientation} against hanging")
    if beam.point_masses:
        out.append(f"{1e3 * sum(p.mass_kg for p in beam.point_masses):.3g} g glued on against none")
    if beam.clamp is not None:
        out.append("a clamp that gives against a rigid one")
    return tuple(out)

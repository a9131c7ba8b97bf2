"""What a run's recordings say to the paper's tables: the measured modes, and how the beam differs from the paper's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modal_id.results import Identification, IdentifiedMode
from modalcam.pipeline.results import RunResult
from sim.beam.properties import BeamProperties
from sim.reference import paper_tables as printed
from tracker.arrays import FloatArray


def target_modes(result: RunResult) -> dict[int, tuple[str, IdentifiedMode]]:
    """Recording and mode of each number: the target of its recording before one that rang along, then the surest."""
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

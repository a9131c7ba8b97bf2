"""Data of a folder for the paper's tables: values used in its simulation, and differences of its beam."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sim import reference as printed
from sim.beam import BeamProperties

TRUTH_NAME = "truth.json"


class TrueMode(NamedTuple):
    """Frequency at small amplitude and damping ratio with which a recording was simulated."""

    frequency_hz: float
    damping_ratio: float


@dataclass(frozen=True)
class Truth:
    """Simulated modes of a folder by number; falsy if empty, with the reason in `note` if its file is unusable."""

    modes: dict[int, TrueMode]
    note: str = ""

    def __bool__(self) -> bool:
        return bool(self.modes)


def read_truth(folder: Path) -> Truth:
    """Simulated modes from `truth.json` in `folder`; empty, without a note, if there is no such file."""
    try:
        entries = json.loads((folder / TRUTH_NAME).read_text("utf-8"))["recordings"]
        modes = {
            int(entry["mode"]): TrueMode(float(entry["frequency_hz"]), float(entry["damping_ratio"]))
            for entry in entries
        }
    except FileNotFoundError:
        return Truth({})
    except (OSError, ValueError, KeyError, TypeError) as error:
        # The measurements are valid without it.
        note = (
            f"{TRUTH_NAME} was not used: expected a list of recordings, each with mode, frequency_hz and "
            f"damping_ratio; found {type(error).__name__}: {error}."
        )
        return Truth({}, note)
    return Truth(modes)


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

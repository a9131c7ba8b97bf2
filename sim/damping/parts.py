"""Measured damping ratios divided into thermoelastic damping, damping by air, and what is left."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.damping.entry import MeasuredDamping
from sim.damping.section import BeamSection
from sim.damping.thermoelastic import thermoelastic_ratio
from sim.damping.viscous_air import viscous_air_ratio
from tracker import INTERVAL_SD, Column, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Standard deviations of what the computed parts depend on."""

    #: [1] relative, of the air damping: flow along the beam, walls, and weather
    #: convention: A two-dimensional flow is not that of a tip, and weather changes the density by 3 %; chosen.
    air_sd: float = 0.1
    #: [1] relative, of the thickness of the beam
    #: convention: Tolerance of thin strip, 0.01 mm of 0.5 mm; chosen.
    thickness_sd: float = 0.02


TUNING = Tuning()
PARTS = ("measured", "thermoelastic", "air", "remainder")
PART_COLUMNS = (
    Column("mode", "", "number of the beam's mode"),
    Column("part", "", ", ".join(PARTS)),
    Column("damping_ratio", "1", "the part at small amplitude; NaN where unknown"),
    Column("damping_ratio_sd", "1", "its standard deviation"),
    Column("damping_ratio_q05", "1", "5 % quantile"),
    Column("damping_ratio_q95", "1", "95 % quantile"),
)


@dataclass(frozen=True)
class DampingParts:
    """Parts of the damping ratios of n modes at small amplitude.

    Attributes
    ----------
    numbers : tuple of int
    value, sd : array, shape (4, n)
        Of `PARTS`: thermoelastic, NaN without a material; air, its viscosity alone, NaN without a section; the
        remainder is material, clamp, joints, radiation, and what is NaN. Below 0, a computed part is too large.
    """

    numbers: tuple[int, ...]
    value: FloatArray
    sd: FloatArray

    @property
    def interval_90(self) -> tuple[FloatArray, FloatArray]:
        """5 % and 95 % quantile, each of shape (4, n)."""
        return self.value - INTERVAL_SD * self.sd, self.value + INTERVAL_SD * self.sd

    def rows(self) -> list[dict[str, Any]]:
        """One row per mode and part, with the columns of ``damping_parts.csv``."""
        table = np.stack([self.value, self.sd, *self.interval_90], axis=2)
        found = [
            (number, part, *row)
            for k, number in enumerate(self.numbers)
            for part, row in zip(PARTS, table[:, k].tolist(), strict=True)
        ]
        return [dict(zip((one.name for one in PART_COLUMNS), row, strict=True)) for row in found]


def damping_parts(measured: MeasuredDamping) -> DampingParts:
    """Divide damping ratios at small amplitude; standard deviations are propagated to first order."""
    omega, section = 2.0 * np.pi * np.array(measured.frequency_hz), measured.section
    unknown = np.full_like(omega, np.nan)
    heat = unknown if section is None else thermoelastic_ratio(omega, section)
    heat_sd = unknown if section is None else _heat_sd(omega, section)
    air = unknown if section is None else viscous_air_ratio(omega, section)
    value = np.array([measured.damping_ratio, heat, air])
    sd = np.array([measured.damping_sd or np.zeros_like(omega), heat_sd, TUNING.air_sd * air])
    rest, rest_sd = value[0] - np.nansum(value[1:], axis=0), np.sqrt(np.nansum(sd**2, axis=0))
    return DampingParts(measured.numbers, np.vstack([value, rest]), np.vstack([sd, rest_sd]))


def _heat_sd(omega: FloatArray, section: BeamSection) -> FloatArray:
    """Standard deviation of the thermoelastic part: of the thickness and of the thermal properties."""
    found, factor = [], 1.0 + TUNING.thickness_sd
    material = section.material
    if material is not None:
        names = ("expansion_1_k", "conductivity_w_m_k", "heat_capacity_j_kg_k")
        for name, sd in zip(names, material.relative_sd, strict=True):
            changed = replace(material, **{name: (1.0 + sd) * getattr(material, name)})
            found.append(replace(section, material=changed))
    found.append(replace(section, thickness_m=factor * section.thickness_m))
    middle = thermoelastic_ratio(omega, section)
    return np.asarray(np.sqrt(sum((thermoelastic_ratio(omega, one) - middle) ** 2 for one in found)))

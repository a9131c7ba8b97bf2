"""Which law holds: evidence of each over all measured modes, and its prediction of each mode from the others.

What was measured is divided into thermoelastic damping, damping by air, and what is left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.damping.entry import BeamSection, MeasuredDamping
from sim.damping.law import LawFit
from sim.damping.laws import thermoelastic_ratio, viscous_air_ratio
from sim.damping.registry import DAMPING_MODELS
from tracker import INTERVAL_SD, Column, Failure, FloatArray

# Below, a mode is left out, and two others are needed to tell a slope over frequency from a level.
_LEAST_MODES = 3
LAW_COLUMNS = (
    Column("law", "", "key of the damping law"),
    Column("parameters", "", "free parameters beside the scatter"),
    Column("log_evidence", "nat", "log density of the measured ln ζ"),
    Column("probability", "1", "of the law, if one of those listed holds"),
    Column("log_score", "nat", "sum of the log densities of the modes left out"),
    Column("damping_ratio", "1", "at the geometric mean of the frequencies, median"),
    Column("damping_ratio_q05", "1", "its 5 % quantile"),
    Column("damping_ratio_q95", "1", "its 95 % quantile"),
    Column("shape_name", "", "name of the law's other parameter"),
    Column("shape", "1", "its mean"),
    Column("shape_sd", "1", "its standard deviation"),
    Column("scatter", "1", "relative standard deviation between modes beyond their own, mean"),
    Column("scatter_sd", "1", "its standard deviation"),
)
LEFT_OUT_COLUMNS = (
    Column("law", "", "key of the damping law"),
    Column("mode", "", "number of the mode left out"),
    Column("frequency_hz", "Hz", "its frequency"),
    Column("damping_ratio_measured", "1", "at small amplitude"),
    Column("damping_ratio", "1", "predicted from the other modes, median"),
    Column("damping_ratio_q05", "1", "5 % quantile"),
    Column("damping_ratio_q95", "1", "95 % quantile"),
    Column("log_density", "nat", "of the measured ln ζ"),
    Column("probability", "1", "of the law, if one of those listed predicts the mode"),
)


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


@dataclass(frozen=True)
class LawComparison:
    """Damping laws over the measured modes, the most probable first, and the parts of each damping ratio.

    Attributes
    ----------
    measured : MeasuredDamping
        Modes and their damping ratios at small amplitude.
    keys : tuple of str
        Of the laws' entries in `DAMPING_MODELS`.
    fits : tuple of LawFit
        One for each key.
    parts : DampingParts
    notes : tuple of str
        Sentences on laws that were left out.
    """

    measured: MeasuredDamping
    keys: tuple[str, ...]
    fits: tuple[LawFit, ...]
    parts: DampingParts
    notes: tuple[str, ...] = ()

    @property
    def probability(self) -> FloatArray:
        """Of each law, all equally probable before the measurement, shape (laws,)."""
        return _shares(np.array([fit.log_evidence for fit in self.fits]))

    @property
    def left_out_probability(self) -> FloatArray:
        """Of each law by its prediction of each mode from the others, shape (laws, modes)."""
        return _shares(np.array([[one.log_density for one in fit.left_out] for fit in self.fits]))

    def rows(self) -> list[dict[str, Any]]:
        """One row per law, with the columns of ``damping_laws.csv``."""
        found = []
        for key, fit, share in zip(self.keys, self.fits, self.probability.tolist(), strict=True):
            law, score = DAMPING_MODELS[key].law, sum(one.log_density for one in fit.left_out)
            head = (key, fit.parameters, fit.log_evidence, share, score)
            found.append((*head, *fit.level, law.shape_name if law else "", *fit.shape, *fit.scatter))
        return [dict(zip((one.name for one in LAW_COLUMNS), row, strict=True)) for row in found]

    def left_out_rows(self) -> list[dict[str, Any]]:
        """One row per law and mode left out, with the columns of ``damping_left_out.csv``."""
        of, found = self.measured, []
        modes = tuple(zip(of.numbers, of.frequency_hz, of.damping_ratio, strict=True))
        for key, fit, shares in zip(self.keys, self.fits, self.left_out_probability.tolist(), strict=True):
            for mode, one, share in zip(modes, fit.left_out, shares, strict=True):
                predicted = (one.damping_ratio, one.q05, one.q95)
                found.append((key, *mode, *predicted, one.log_density, share))
        return [dict(zip((one.name for one in LEFT_OUT_COLUMNS), row, strict=True)) for row in found]


def compare_laws(measured: MeasuredDamping) -> LawComparison | Failure:
    """Compare all registered laws over the measured modes.

    Parameters
    ----------
    measured : MeasuredDamping
        Modes with damping ratios at small amplitude, in order of frequency. Laws that are computed need its `section`.

    Returns
    -------
    LawComparison or Failure
        The latter for fewer than three modes, or a damping ratio that is not positive.
    """
    count = len(measured.numbers)
    if count < _LEAST_MODES or not min(measured.damping_ratio) > 0.0:
        ratios = ", ".join(f"{100.0 * ratio:.3g}" for ratio in measured.damping_ratio)
        found = f"{count} modes with damping ratios of {ratios} %"
        return Failure(
            f"damping laws need at least {_LEAST_MODES} modes with positive damping ratios, found {found}"
        )
    laws = {key: entry.law for key, entry in DAMPING_MODELS.items() if entry.law is not None}
    missing = {key: law.lacks(measured.section) for key, law in laws.items()}
    fits = {key: law.fit(measured) for key, law in laws.items() if not missing[key]}
    keys = tuple(sorted(fits, key=lambda key: -fits[key].log_evidence))
    notes = tuple(
        f"Damping laws that need {one} were left out." for one in sorted({*missing.values()} - {""})
    )
    return LawComparison(measured, keys, tuple(fits[key] for key in keys), damping_parts(measured), notes)


def _shares(log_density: FloatArray) -> FloatArray:
    shares = np.exp(log_density - np.max(log_density, axis=0))
    return np.asarray(shares / np.sum(shares, axis=0))

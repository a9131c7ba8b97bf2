"""Which law holds: evidence of each over all measured modes, and its prediction of each mode from the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.damping.entry import MeasuredDamping
from sim.damping.law import LawFit
from sim.damping.parts import DampingParts, damping_parts
from sim.damping.registry import DAMPING_MODELS
from tracker import Column, Failure, FloatArray

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

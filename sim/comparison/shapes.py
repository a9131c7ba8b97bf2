"""Effect of the uncertainty of the beam's properties on its shape, and so on every simulated decay.

The identified modes keep their measured frequencies for any properties, and the start is the measured one: drawn
properties change the motion of the markers through the shapes only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modal_id.results import Identification
from sim.beam.ancf import AncfBeam
from sim.beam.modes import beam_modes
from sim.beam.properties import BeamProperties
from sim.beam.statics import BuckledBeamError, NoEquilibriumError
from sim.comparison.bands import Simulated
from sim.comparison.matching import match_modes
from sim.comparison.problem import DecaySetting
from sim.comparison.scores import SD_OF_90
from tracker.arrays import FloatArray


def shape_sd(
    setting: DecaySetting, identification: Identification, beams: Sequence[BeamProperties]
) -> FloatArray:
    """Standard deviation of the motion of each marker over the drawn beams, per unit of the target's coordinate.

    Returns
    -------
    array, shape (k,)
        0 if fewer than two of the beams have the mode.
    """
    columns = []
    for properties in beams:
        try:
            modes = beam_modes(AncfBeam(properties), setting.modes.count)
            matched = match_modes(identification, modes)
        except (BuckledBeamError, NoEquilibriumError):
            continue
        if isinstance(matched, str) or matched.target_number != setting.matched.target_number:
            continue
        own = _target(matched.numbers, matched.coordinate, matched.target_number)
        before = _target(setting.matched.numbers, setting.matched.coordinate, setting.matched.target_number)
        columns.append(matched.shapes[:, setting.at] * (own / before).real)
    if len(columns) < 2:
        return np.zeros(setting.positions_m.size)
    return np.asarray(np.sqrt(np.mean((np.array(columns) - setting.shape) ** 2, axis=0)))


def with_shapes(setting: DecaySetting, run: Simulated, sd_m: FloatArray) -> Simulated:
    """A simulation with a band widened by the uncertainty of the shape; `sd_m` as from `shape_sd`."""
    if not np.any(sd_m > 0.0):
        return run
    coordinate = run.central @ setting.shape / float(setting.shape @ setting.shape)
    sd = np.abs(np.outer(coordinate, sd_m))
    low = run.central if run.low is None else run.low
    high = run.central if run.high is None else run.high
    middle, reach = 0.5 * (low + high), 0.5 * (high - low)
    wide = np.hypot(reach, SD_OF_90 * sd)
    return Simulated(run.central, middle - wide, middle + wide, run.sd, sd, run.note)


def _target(numbers: NDArray[np.int64], values: NDArray[np.complex128], number: int) -> complex:
    return complex(values[int(np.flatnonzero(numbers == number)[0])])

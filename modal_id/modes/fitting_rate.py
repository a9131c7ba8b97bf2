"""The sampling rate at which the lines of a record are modes of the beam, where they are not at the recorded rate."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modal_id.modes.shapes import mac
from modal_id.record import FittingRate
from modal_id.settings import IdentifySettings
from tracker import ComplexArray, FloatArray

# Largest ratio of measured to theoretical frequency (clamp, gravity, added mass); modes are further apart.
MAX_LOG_RATIO = float(np.log(1.3))
MATCHING_MAC = 0.95
# Below this MAC two shapes are not those of one mode: consistent ones reach 0.9 (Allemang, "The modal assurance
# criterion: twenty years of use and abuse", Sound Vib. 37 (2003) 14-23), and positions read to 2 mm of 500 cost 0.1.
OTHER_SHAPE_MAC = 0.8
# Rates that cameras offer, and the error of theory up to which one of them is named: the standard beam of the paper is
# stiffer than the measured one by 7 % in mode 4.
_USUAL_RATES_HZ = (
    24, 25, 30, 48, 50, 60, 90, 100, 120, 125, 150, 200, 240, 250, 300, 400, 480, 500, 600, 720, 750, 800, 960, 1000,
    1200, 1250, 1500, 2000, 2400, 2500, 3000, 4000, 5000, 6000, 8000, 10000,
)  # fmt: skip


@dataclass(frozen=True)
class Tuning:
    """Rates that fit the theory."""

    #: [1] relative error of the theory up to which a usual frame rate is named
    #: measurement: The standard beam of the paper is stiffer than the measured one by 7 % in mode 4.
    rate_error: float = 0.1


TUNING = Tuning()


def theory_macs(shapes: ComplexArray, expected_shapes: FloatArray | None, modes: int) -> FloatArray:
    """MAC of each of m shapes, shape (m, k), with each theoretical one; shape (m, `modes`), NaN where unknown."""
    if expected_shapes is None or expected_shapes.shape[0] != shapes.shape[1]:
        return np.full((shapes.shape[0], modes), np.nan)
    return np.array([[mac(shape, column) for column in expected_shapes.T] for shape in shapes])


def fitting_rate(
    frequencies_hz: FloatArray,
    shapes: ComplexArray,
    strength: FloatArray,
    numbers: tuple[int | None, ...],
    settings: IdentifySettings,
    rate_hz: float,
) -> FittingRate | None:
    """The rate at which the strongest of m lines would be a mode of the beam; None where nothing speaks for another.

    `shapes` has shape (m, k), `strength` (m,). The strongest line whose shape is that of one mode only decides, by its
    frequency. The frequency alone decides where no shape does, for the mode that is wanted and not found, unless the
    shape of the strongest line contradicts that mode; `FittingRate.otherwise` is the mode near it at the recorded rate.
    """
    expected = np.asarray(settings.expected_frequencies_hz, dtype=float)
    if not expected.size or not frequencies_hz.size:
        return None
    macs = theory_macs(shapes, settings.expected_shapes, expected.size)
    of_shape = [_number_of_shape(row) for row in macs]
    wanted = settings.mode if settings.mode is not None and settings.mode <= expected.size else None
    deciding = [line for line in np.argsort(-strength, kind="stable") if of_shape[line] is not None]
    misplaced = {
        line: number
        for line in deciding
        if (number := of_shape[line])
        and abs(np.log(frequencies_hz[line] / expected[number - 1])) > MAX_LOG_RATIO
    }
    if deciding:
        line = int(deciding[0])
        number = misplaced.get(line)
        if number is None or not _speaks(
            macs, numbers, wanted, number, all_misplaced=len(misplaced) == len(deciding)
        ):
            return None
        return _rate(float(frequencies_hz[line]), number, float(expected[number - 1]), rate_hz)
    line = int(np.argmax(strength))
    if wanted is None or wanted in numbers:
        return None
    turned = theory_macs(shapes, settings.reversed_shapes, expected.size)
    if np.fmax(macs, turned)[line, wanted - 1] < OTHER_SHAPE_MAC:
        return None
    fitting = _rate(float(frequencies_hz[line]), wanted, float(expected[wanted - 1]), rate_hz)
    return replace(fitting, otherwise=numbers[line])


def _speaks(
    macs: FloatArray, numbers: tuple[int | None, ...], wanted: int | None, number: int, *, all_misplaced: bool
) -> bool:
    """Whether a strongest line with the shape of mode `number`, at another frequency, speaks against the rate.

    A wanted mode that was found speaks for the rate, unless its shape is another one and the strongest line has it.
    Where none is wanted any other line in its place does: what is strongest then may be a motion of the support.
    """
    if wanted is None:
        return all_misplaced
    if wanted not in numbers:
        return True
    return number == wanted and bool(macs[numbers.index(wanted), wanted - 1] < OTHER_SHAPE_MAC)


def _number_of_shape(macs: FloatArray) -> int | None:
    """Number of the only mode whose shape a line has, from its MAC with each; None where it has none or several."""
    if not np.any(macs >= MATCHING_MAC) or np.count_nonzero(macs >= OTHER_SHAPE_MAC) > 1:
        return None
    return int(np.nanargmax(macs)) + 1


def _rate(line_hz: float, number: int, expected_hz: float, rate_hz: float) -> FittingRate:
    fitting_hz = expected_hz / line_hz * rate_hz
    usual_hz = float(min(_USUAL_RATES_HZ, key=lambda usual: abs(np.log(usual / fitting_hz))))
    if abs(np.log(usual_hz / fitting_hz)) < TUNING.rate_error:
        return FittingRate(rate_hz, (usual_hz, usual_hz), usual_hz / rate_hz, line_hz, number)
    limits_hz = ((1.0 - TUNING.rate_error) * fitting_hz, (1.0 + TUNING.rate_error) * fitting_hz)
    return FittingRate(rate_hz, limits_hz, fitting_hz / rate_hz, line_hz, number)

"""Numbers of identified modes from theoretical frequencies and shapes, and the choice of the target mode."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from modal_id.flags import SHAPE_DISAGREES_NOTE
from modal_id.modes.shapes import mac
from modal_id.settings import IdentifySettings
from tracker.arrays import BoolArray, ComplexArray, FloatArray

# Largest ratio of measured to theoretical frequency (clamp, gravity, added mass); modes are further apart.
_MAX_LOG_RATIO = float(np.log(1.3))
_MAC_WEIGHT = 0.25
_THEORY_ERROR = 0.06
# Rates that cameras offer, and the error of theory up to which one of them is named: the standard beam of the paper is
# stiffer than the measured one by 7 % in mode 4.
_USUAL_RATES_HZ = (
    24, 25, 30, 48, 50, 60, 90, 100, 120, 125, 150, 200, 240, 250, 300, 400, 480, 500, 600, 720, 750, 800, 960, 1000,
    1200, 1250, 1500, 2000, 2400, 2500, 3000, 4000, 5000, 6000, 8000, 10000,
)  # fmt: skip
_RATE_ERROR = 0.1
_MATCHING_MAC = 0.95
# Below this MAC two shapes are not those of one mode: consistent ones reach 0.9 (Allemang, "The modal assurance
# criterion: twenty years of use and abuse", Sound Vib. 37 (2003) 14-23), and positions read to 2 mm of 500 cost 0.1.
_OTHER_SHAPE_MAC = 0.8
# Noise lowers the MAC by its share of the shape's power, in the mean; a chi-square of two or more degrees of freedom
# exceeds seven times its mean once in 1000.
_MOST_NOISE = 7.0
_REJECTED_LOG_RATIO = 0.01


@dataclass(frozen=True)
class Numbering:
    """Number (1 first) of each mode or None, and its MAC with that theoretical shape (NaN without)."""

    numbers: tuple[int | None, ...]
    macs: tuple[float, ...]


def number_modes(
    frequencies_hz: FloatArray, shapes: ComplexArray, strength: FloatArray, settings: IdentifySettings
) -> Numbering:
    """Assign each of m identified modes at most one theoretical mode, and the reverse.

    `shapes` has shape (m, k). Of two candidates for one theoretical mode, the one with the larger `strength`, shape
    (m,), is preferred.
    """
    expected = np.asarray(settings.expected_frequencies_hz, dtype=float)
    m = frequencies_hz.size
    if expected.size == 0 or m == 0:
        return Numbering((None,) * m, (float("nan"),) * m)
    ratio = np.abs(np.log(frequencies_hz[:, None] / expected[None, :]))
    macs = np.full(ratio.shape, np.nan)
    if settings.expected_shapes is not None and settings.expected_shapes.shape[0] == shapes.shape[1]:
        macs = np.array([[mac(shape, column) for column in settings.expected_shapes.T] for shape in shapes])
    weakness = 0.05 * np.log10(np.max(strength) / np.maximum(strength, 1e-300))
    cost = ratio + _MAC_WEIGHT * (1.0 - np.nan_to_num(macs, nan=1.0)) + weakness[:, None]
    cost = np.where(ratio < _MAX_LOG_RATIO, cost, 1e3)
    rows, columns = linear_sum_assignment(cost)
    numbers: list[int | None] = [None] * m
    values = [float("nan")] * m
    for row, column in zip(rows, columns, strict=True):
        if cost[row, column] < 1e3:
            numbers[row] = int(column) + 1
            values[row] = float(macs[row, column])
    return Numbering(tuple(numbers), tuple(values))


@dataclass(frozen=True)
class TargetChoice:
    """Index of the target mode, or None with the reason; not `requested` where it is the strongest mode by default."""

    index: int | None
    reason: str = ""
    frequency_hz: float = float("nan")
    requested: bool = True


def choose_target(
    frequencies_hz: FloatArray,
    strength: FloatArray,
    numbers: tuple[int | None, ...],
    settings: IdentifySettings,
    rate_hz: float,
) -> TargetChoice:
    """The target mode: by number, by frequency, or the strongest."""
    expected = settings.expected_frequencies_hz
    number = settings.mode
    if number is not None and number <= len(expected):
        if number in numbers:
            return TargetChoice(numbers.index(number))
        seen = ", ".join(f"{f:.4g}" for f in frequencies_hz)
        return TargetChoice(
            None,
            f"mode {number} is expected near {expected[number - 1]:.4g} Hz, but the modes found are at {seen} Hz; "
            f"{_in_other_unit(frequencies_hz, expected[number - 1], 'a quantity of the beam is in another unit')}"
            f"{_fitting_rate(frequencies_hz[int(np.argmax(strength))], expected[number - 1], rate_hz)}"
            "check the recorded frame rate, the properties of the beam and the mode given for the recording",
            expected[number - 1],
        )
    if number is not None and expected:
        return TargetChoice(
            None,
            f"mode {number} is requested, but theory provides only modes 1 to {len(expected)}; give a lower number",
        )
    target_hz = settings.target_frequency_hz
    if target_hz is not None:
        ratio = np.abs(np.log(frequencies_hz / target_hz))
        nearest = int(np.argmin(ratio))
        if ratio[nearest] < np.log(1.1):
            return TargetChoice(nearest)
        return TargetChoice(None, _not_found(frequencies_hz, target_hz, rate_hz), target_hz)
    return TargetChoice(int(np.argmax(strength)), requested=False)


def rejected_modes(frequencies_hz: FloatArray, settings: IdentifySettings) -> BoolArray:
    """Which of the modes found the user rejects, shape (m,)."""
    wanted = np.asarray(settings.reject_hz, dtype=float)
    apart = np.abs(np.log(frequencies_hz[:, None] / wanted[None, :]))
    return np.asarray(np.any(apart < _REJECTED_LOG_RATIO, axis=1))


def choose_target_of(
    rejected: BoolArray,
    frequencies_hz: FloatArray,
    strength: FloatArray,
    numbers: tuple[int | None, ...],
    settings: IdentifySettings,
    rate_hz: float,
) -> TargetChoice:
    """As `choose_target`, among the modes that are not rejected."""
    kept = np.flatnonzero(~rejected)
    if not kept.size:
        return TargetChoice(None, "reject_hz names every mode that was found; remove one from it")
    choice = choose_target(
        frequencies_hz[kept], strength[kept], tuple(numbers[k] for k in kept), settings, rate_hz
    )
    return choice if choice.index is None else replace(choice, index=int(kept[choice.index]))


def _not_found(frequencies_hz: FloatArray, wanted_hz: float, rate_hz: float) -> str:
    seen = ", ".join(f"{f:.4g}" for f in frequencies_hz)
    text = f"no mode was found within 10 % of {wanted_hz:.4g} Hz; the modes found are at {seen} Hz. "
    if other := _in_other_unit(frequencies_hz, wanted_hz, "give the requested frequency in Hz, not in kHz"):
        return text + other.removesuffix("; ")
    if wanted_hz > 0.5 * rate_hz:
        return text + (
            f"At a sampling rate of {rate_hz:.4g} Hz, {wanted_hz:.4g} Hz would appear at "
            f"{_alias_hz(wanted_hz, rate_hz):.4g} Hz: record at more than {2.0 * wanted_hz:.4g} Hz or request the alias"
        )
    return (
        text + "Check the requested frequency and the recorded frame rate, with which all frequencies scale"
    )


def _in_other_unit(frequencies_hz: FloatArray, wanted_hz: float, above: str) -> str:
    """Clause on a frequency that is a thousandth of the wanted one, or 1000 times it, which `above` explains."""
    below = "give the frame rate in Hz, not in kHz"
    for factor, text, cause in ((1e-3, "a thousandth of", below), (1e3, "1000 times", above)):
        near = np.abs(np.log(frequencies_hz / (factor * wanted_hz))) < _MAX_LOG_RATIO
        if np.any(near):
            return f"{frequencies_hz[near][0]:.4g} Hz is {text} it: {cause}; "
    return ""


def _fitting_rate(strongest_hz: float, wanted_hz: float, rate_hz: float) -> str:
    """Clause on the sampling rate at which the strongest line would be the wanted mode."""
    ratio = wanted_hz / float(strongest_hz)
    usual = min(_USUAL_RATES_HZ, key=lambda usual: abs(np.log(usual / (ratio * rate_hz))))
    near = abs(np.log(usual / (ratio * rate_hz))) < _RATE_ERROR
    rate = f"{usual:g} Hz" if near else f"{(1.0 - _RATE_ERROR) * ratio * rate_hz:.3g} to "
    rate += "" if near else f"{(1.0 + _RATE_ERROR) * ratio * rate_hz:.3g} Hz"
    factor = usual / rate_hz if near else ratio
    return (
        f"the strongest line, {strongest_hz:.4g} Hz, fits the mode at a sampling rate of {rate} (recorded: "
        f"{rate_hz:.4g} Hz), a ratio of {factor:.3g}; "
    )


def _alias_hz(frequency_hz: float, rate_hz: float) -> float:
    """Apparent frequency, between 0 and half the sampling rate."""
    return float(abs(frequency_hz - rate_hz * round(frequency_hz / rate_hz)))


def possible_aliases(
    frequency_hz: float,
    shape: ComplexArray,
    number: int | None,
    rate_hz: float,
    settings: IdentifySettings,
) -> tuple[int, ...]:
    """Numbers of theoretical modes above half the sampling rate that would appear at an identified frequency.

    A theoretical frequency may be off by 6 %, and its alias by the same number of Hz. A shape that matches the assigned
    mode and not the alias rules the alias out.
    """
    found = []
    own = _mac(shape, number, settings)
    for index, expected in enumerate(settings.expected_frequencies_hz):
        if expected <= 0.5 * rate_hz:
            continue
        near = abs(_alias_hz(expected, rate_hz) - frequency_hz) < _THEORY_ERROR * expected
        other = _mac(shape, index + 1, settings)
        ruled_out = own > _MATCHING_MAC and other < _MATCHING_MAC
        if near and not ruled_out:
            found.append(index + 1)
    return tuple(found)


def shape_disagreement(
    shape: ComplexArray, shape_sd: FloatArray, number: int | None, settings: IdentifySettings
) -> str:
    """A sentence where the shape is not that of theory, with noise allowed for; empty where it may be."""
    own = _mac(shape, number, settings)
    power = float(np.nansum(np.abs(shape) ** 2))
    noise = _MOST_NOISE * 2.0 * float(np.nansum(shape_sd**2)) / max(power, 1e-300)
    if number is None or not own + noise < _OTHER_SHAPE_MAC:
        return ""
    turned = settings.reversed_shapes
    other = float("nan") if turned is None else mac(shape, turned[:, number - 1])
    if other >= _MATCHING_MAC:
        return f"{SHAPE_DISAGREES_NOTE} (MAC {own:.2g}); with the clamp at the other end {other:.2g}."
    return f"{SHAPE_DISAGREES_NOTE} (MAC {own:.2g})."


def _mac(shape: ComplexArray, number: int | None, settings: IdentifySettings) -> float:
    shapes = settings.expected_shapes
    if shapes is None or number is None or number > shapes.shape[1]:
        return float("nan")
    return mac(shape, shapes[:, number - 1])

"""Numbers of identified modes from theoretical frequencies and shapes, and the rate at which the lines fit them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from modal_id.fit import SAME_LINE
from modal_id.modes.aliases import apparent_hz
from modal_id.modes.shapes import mac
from modal_id.record import FittingRate
from modal_id.results import FailedMode, IdentifiedMode
from modal_id.sentences import ModeFlag, Note, Reason, Refusal, in_hz
from modal_id.settings import IdentifySettings
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Numbers of the modes, and rates that fit the theory."""

    #: [1] relative error of the theory up to which a usual frame rate is named
    #: measurement: The standard beam of the paper is stiffer than the measured one by 7 % in mode 4.
    rate_error: float = 0.1
    #: [1] weight of the MAC relative to the frequency
    mac_weight: float = 0.25
    #: [1] relative sd of the theoretical frequencies
    theory_error: float = 0.06
    #: [1] factor on the mean effect of the noise on the MAC, up to which a lower MAC is allowed
    #: statistics: A chi-square of two or more degrees of freedom exceeds seven times its mean once in 1000.
    most_noise: float = 7.0
    #: [1] error of theory's shapes, as 1 - MAC, with which both ends are compared
    #: measurement: Positions of 2 to 8 markers read to 2 mm of 500 cost up to 0.007 in 95 of 100 shapes of modes 1-5.
    shape_error: float = 0.01
    #: [1] odds from which the other end is named
    #: measurement: The largest of 3000 shapes of this end, 2 to 8 markers read to 5 mm, is 58.
    least_odds: float = 100.0


TUNING = Tuning()


# Largest ratio of measured to theoretical frequency (clamp, gravity, added mass); modes are further apart.
MAX_LOG_RATIO = float(np.log(1.3))
MATCHING_MAC = 0.95
# Below this MAC two shapes are not those of one mode: consistent ones reach 0.9 (Allemang, "The modal assurance
# criterion: twenty years of use and abuse", Sound Vib. 37 (2003) 14-23), and positions read to 2 mm of 500 cost 0.1.
OTHER_SHAPE_MAC = 0.8
# Rates that cameras offer.
_USUAL_RATES_HZ = (
    24, 25, 30, 48, 50, 60, 90, 100, 120, 125, 150, 200, 240, 250, 300, 400, 480, 500, 600, 720, 750, 800, 960, 1000,
    1200, 1250, 1500, 2000, 2400, 2500, 3000, 4000, 5000, 6000, 8000, 10000,
)  # fmt: skip


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
    macs = theory_macs(shapes, settings.expected_shapes, expected.size)
    weakness = 0.05 * np.log10(np.max(strength) / np.maximum(strength, 1e-300))
    cost = ratio + TUNING.mac_weight * (1.0 - np.nan_to_num(macs, nan=1.0)) + weakness[:, None]
    cost = np.where(ratio < MAX_LOG_RATIO, cost, 1e3)
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
    """Index of the target mode, or None with the reason; not `requested` where it is the strongest mode by default.

    `fitting` is another sampling rate at which a line would be a mode of the beam.
    """

    index: int | None
    why: Refusal = Refusal("")  # noqa: RUF009 - frozen
    frequency_hz: float = float("nan")
    requested: bool = True
    fitting: FittingRate | None = None


def choose_target(
    frequencies_hz: FloatArray,
    shapes: ComplexArray,
    strength: FloatArray,
    numbers: tuple[int | None, ...],
    settings: IdentifySettings,
    rate_hz: float,
) -> TargetChoice:
    """The target mode: by number, by frequency, or the strongest; a number only where no other rate fits.

    `shapes` has shape (m, k), the other arrays (m,).
    """
    expected = settings.expected_frequencies_hz
    number = settings.mode
    fitting = fitting_rate(frequencies_hz, shapes, strength, numbers, settings, rate_hz)
    if number is not None and number <= len(expected):
        if number in numbers and fitting is None:
            return TargetChoice(numbers.index(number))
        hz = expected[number - 1]
        seen = Note.MODES_AT(hz=in_hz(frequencies_hz))
        if number in numbers:
            seen = Note.OTHER_SHAPE(hz=frequencies_hz[numbers.index(number)])
        unit = _in_other_unit(frequencies_hz, hz, Note.UNIT_OF_BEAM, Note.UNIT_OF_RATE_OR_BEAM)
        before, after = (f"{clause}; " if clause else "" for clause in (fitting, unit))
        why = Reason.NUMBER_NOT_FOUND(number=number, expected_hz=hz, seen=seen, fitting=before, unit=after)
        return TargetChoice(None, why, hz, fitting=fitting)
    if number is not None and expected:
        return TargetChoice(None, Reason.BEYOND_THEORY(number=number, count=len(expected)))
    target_hz = settings.target_frequency_hz
    if target_hz is not None:
        ratio = np.abs(np.log(frequencies_hz / target_hz))
        nearest = int(np.argmin(ratio))
        if ratio[nearest] < np.log(1.1):
            return TargetChoice(nearest, fitting=fitting)
        return TargetChoice(None, _not_found(frequencies_hz, target_hz, rate_hz), target_hz, fitting=fitting)
    return TargetChoice(int(np.argmax(strength)), requested=False, fitting=fitting)


def rejected_modes(frequencies_hz: FloatArray, settings: IdentifySettings) -> BoolArray:
    """Which of the modes found the user rejects, shape (m,)."""
    wanted = np.asarray(settings.reject_hz, dtype=float)
    apart = np.abs(np.log(frequencies_hz[:, None] / wanted[None, :]))
    return np.asarray(np.any(apart < SAME_LINE, axis=1))


def choose_target_of(
    rejected: BoolArray,
    frequencies_hz: FloatArray,
    shapes: ComplexArray,
    strength: FloatArray,
    numbers: tuple[int | None, ...],
    settings: IdentifySettings,
    rate_hz: float,
) -> TargetChoice:
    """As `choose_target`, among the modes that are not rejected."""
    kept = np.flatnonzero(~rejected)
    if not kept.size:
        return TargetChoice(None, Reason.ALL_REJECTED())
    choice = choose_target(
        frequencies_hz[kept], shapes[kept], strength[kept], tuple(numbers[k] for k in kept), settings, rate_hz
    )
    return choice if choice.index is None else replace(choice, index=int(kept[choice.index]))


def numbered(
    modes: list[IdentifiedMode], settings: IdentifySettings, rate_hz: float
) -> tuple[tuple[IdentifiedMode, ...], list[FailedMode]]:
    """Modes with their numbers in theory and the target marked; those that the user rejects, and a missing target."""
    if not modes:
        return (), []
    frequencies_hz = np.array([mode.frequency_hz for mode in modes])
    shapes = np.stack([mode.shape for mode in modes])
    strength = np.array([mode.amplitude for mode in modes])
    rejected = rejected_modes(frequencies_hz, settings)
    found = number_modes(frequencies_hz, shapes, strength, settings)
    choice = choose_target_of(rejected, frequencies_hz, shapes, strength, found.numbers, settings, rate_hz)
    kept, failed = [], []
    for index, mode in enumerate(modes):
        number = found.numbers[index]
        if rejected[index]:
            failed.append(FailedMode.of(Reason.NO_MODE(), float(frequencies_hz[index])))
            continue
        one = replace(mode, number=number, target=index == choice.index, mac=found.macs[index])
        words = shape_disagreement(mode.shape, mode.shape_sd, number, settings)
        kept.append(one.with_flags([ModeFlag.SHAPE_DISAGREES], words) if words else one)
    if choice.index is None:
        failed.append(missing_target(choice, settings))
    return tuple(kept), failed


def missing_target(choice: TargetChoice, settings: IdentifySettings) -> FailedMode:
    """The target that was not found."""
    return FailedMode.of(choice.why, choice.frequency_hz, settings.mode, target=True)


def _not_found(frequencies_hz: FloatArray, wanted_hz: float, rate_hz: float) -> Refusal:
    cause = _in_other_unit(frequencies_hz, wanted_hz, Note.UNIT_OF_TARGET, Note.UNIT_OF_RATE)
    if not cause and wanted_hz > 0.5 * rate_hz:
        alias_hz = apparent_hz(wanted_hz, rate_hz)
        cause = Note.APPEARS(rate_hz=rate_hz, hz=wanted_hz, alias_hz=alias_hz, least_hz=2.0 * wanted_hz)
    return Reason.NOT_WITHIN(hz=wanted_hz, seen=in_hz(frequencies_hz), cause=cause or Note.CHECK_RATE())


def _in_other_unit(frequencies_hz: FloatArray, wanted_hz: float, above: Note, below: Note) -> str:
    """Clause on a frequency that is a thousandth of the wanted one, or 1000 times it, which the notes explain."""
    for factor, words, cause in ((1e-3, Note.THOUSANDTH, below), (1e3, Note.THOUSANDFOLD, above)):
        near = np.abs(np.log(frequencies_hz / (factor * wanted_hz))) < MAX_LOG_RATIO
        if np.any(near):
            return words(hz=frequencies_hz[near][0], cause=cause())
    return ""


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
        near = abs(apparent_hz(expected, rate_hz) - frequency_hz) < TUNING.theory_error * expected
        other = _mac(shape, index + 1, settings)
        ruled_out = own > MATCHING_MAC and other < MATCHING_MAC
        if near and not ruled_out:
            found.append(index + 1)
    return tuple(found)


def shape_disagreement(
    shape: ComplexArray, shape_sd: FloatArray, number: int | None, settings: IdentifySettings
) -> str:
    """A sentence where the shape is not that of theory, with noise allowed for; empty where it may be."""
    own = _mac(shape, number, settings)
    power = float(np.nansum(np.abs(shape) ** 2))
    noise = TUNING.most_noise * 2.0 * float(np.nansum(shape_sd**2)) / max(power, 1e-300)
    if number is None or np.isnan(own):
        return ""
    turned = settings.reversed_shapes
    other = 0.0 if turned is None else mac(shape, turned[:, number - 1])
    # Errors of unknown size in all directions but that of the shape, of which there is one less than channels.
    error = TUNING.shape_error + noise
    odds = ((1.0 - own + error) / (1.0 - other + error)) ** (np.count_nonzero(np.isfinite(shape)) - 1)
    if odds > TUNING.least_odds:
        return Note.SHAPE_TURNED(mac=own, turned_mac=other)
    return Note.SHAPE_DISAGREES(mac=own) if own + noise < OTHER_SHAPE_MAC else ""


def _mac(shape: ComplexArray, number: int | None, settings: IdentifySettings) -> float:
    shapes = settings.expected_shapes
    if shapes is None or number is None or number > shapes.shape[1]:
        return float("nan")
    return mac(shape, shapes[:, number - 1])

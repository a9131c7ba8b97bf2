"""Where a further mode may be: local rational fits of the residual spectrum about its peaks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from modal_id.response.noise import TUNING as NOISE
from modal_id.response.solution import ResponseFit
from tracker import BoolArray, ComplexArray


@dataclass(frozen=True)
class Tuning:
    """Peaks, and the poles that are tried about them."""

    #: [1] peaks of the residual spectrum about which a pole is sought
    peaks: int = 8
    #: [1] smallest damping ratio that is tried
    #: convention: That of a tuning fork.
    least_damping: float = 0.001
    #: [1] largest one, from which a pole is left out of the search for the lag
    #: measurement: What a wrong lag leaves of a motion of the base over the whole band is taken for modes of 0.02 to
    #: 0.5, which then follow any lag (seeds 0 and 1 of the broad records of benchmarks/known_input.py).
    most_damping: float = 0.05
    #: [1] number of damping ratios that are tried
    #: physics: The iteration covers the factor of three between neighbours.
    ratios: int = 5
    #: [1] damping ratio up to which a mode is slightly damped
    #: physics: The window of a stronger one holds other modes of a beam.
    slight: float = 0.01
    #: [1] frequencies that are tried about a peak for each damping ratio
    frequencies: int = 7
    #: [1] their reach on both sides, in half-widths of the mode, a bin at least
    #: physics: Noise moves the highest bin within the width of a resonance.
    reach: float = 1.5
    #: [1] half-widths of a mode on both sides of a window
    #: physics: 0.8 of the power of a resonance lies within three.
    half_widths: float = 5.0
    #: [1] relative distance of two peaks
    apart: float = 0.05
    #: [bins] half width of the average of the input's spectrum
    near: int = 4
    #: [1] power of the input over that of its noise below which it drives no mode that can be told
    #: statistics: The mean of nine bins of noise exceeds three times its expectation once in 30 000.
    least_power: float = 3.0


TUNING = Tuning()


def candidates(found: ResponseFit, lowest_hz: float, least_gain: float) -> list[complex]:
    """Poles that explain peaks of the residual, each with a gain of log likelihood above `least_gain`.

    One slightly and one strongly damped pole about each peak. Peaks below `lowest_hz`, or where the input does not
    exceed its noise, do not count.

    Notes
    -----
    Local rational method (McKelvey & Guerin 2012, doi:10.3182/20120711-3-BE-2027.00425): about a peak, the residual is
    ``(a / (s - lambda) + a0 + a1 x) U + b / (s - lambda) + b0 + b1 x`` with U the transform of the likely input. At a
    given lambda all but it are linear.
    """
    samples, size = found.samples, found.weights.shape[0]
    residual = found.residual_bins
    power = uniform_filter1d(np.sum(np.abs(residual) ** 2 * found.weights, axis=1), 3)
    frequency_hz, taken = samples.frequency_hz, np.zeros(size, dtype=bool)
    taken[frequency_hz < max(lowest_hz, 2.0 / samples.span_s)] = True
    taken |= ~is_driven(found)
    weighted = residual * np.sqrt(found.weights)
    tried: list[tuple[float, complex]] = []
    ratios = np.geomspace(TUNING.least_damping, TUNING.most_damping, TUNING.ratios)
    for _ in range(TUNING.peaks):
        if taken.all():
            break
        at = int(np.argmax(np.where(taken, -1.0, power)))
        hz = frequency_hz[at]
        taken |= np.abs(frequency_hz - hz) < max(TUNING.apart * hz, 3.0 / samples.span_s)
        tried.extend(
            max((_tried(found, weighted, at, ratio) for ratio in own), key=_gain)
            for own in (ratios[ratios <= TUNING.slight], ratios[ratios > TUNING.slight])
        )
    return [pole for gain, pole in tried if gain > least_gain]


def _gain(one: tuple[float, complex]) -> float:
    return one[0]


def is_driven(found: ResponseFit) -> BoolArray:
    """Bins near which the input exceeds its noise: a response to noise alone has no instrument; shape (b,)."""
    power = uniform_filter1d(np.abs(found.samples.content_bins) ** 2, 2 * TUNING.near + 1)
    return np.asarray(power > TUNING.least_power * 2.0 * found.noise.input)


def drives(found: ResponseFit) -> BoolArray:
    """Whether the input exceeds its noise somewhere about the resonance of each mode; shape (m,).

    Not at its frequency: the lines of a periodic input may lie on both sides of it.
    """
    driven, frequency_hz = is_driven(found), found.samples.frequency_hz
    hz = np.abs(found.poles) / (2.0 * np.pi)
    # Half the distance that peaks of the residual keep, for a slightly damped mode between two lines.
    near = np.abs(frequency_hz[:, None] - hz) < 0.5 * TUNING.apart * hz
    return np.asarray(np.any(driven[:, None] & near, axis=0))


def _tried(found: ResponseFit, weighted: ComplexArray, at: int, ratio: float) -> tuple[float, complex]:
    """Gain of log likelihood and the best pole of a damping ratio about the bin `at`."""
    samples = found.samples
    frequency_hz = samples.frequency_hz
    step_hz = float(frequency_hz[1] - frequency_hz[0])
    half_hz = ratio * float(frequency_hz[at])
    reach = max(NOISE.half_window, int(np.ceil(TUNING.half_widths * half_hz / step_hz)))
    window = slice(max(0, at - reach), at + reach + 1)
    size = len(weighted[window])
    s, driving = 2j * np.pi * frequency_hz[window], found.likely.input_bins[window]
    root = np.sqrt(np.mean(found.weights[window], axis=1))
    x = np.linspace(-1.0, 1.0, size)
    basis = np.linalg.qr((np.stack([driving, driving * x, np.ones(size), x], axis=1)) * root[:, None])[0]
    rest = weighted[window] - basis @ (np.conj(basis.T) @ weighted[window])
    left = np.maximum(np.sum(np.abs(rest) ** 2, axis=0), 1e-300)
    best = (0.0, 0.0j)
    for offset in np.linspace(-TUNING.reach, TUNING.reach, TUNING.frequencies) * max(half_hz, step_hz):
        omega = 2.0 * np.pi * (float(frequency_hz[at]) + offset)
        pole = complex(-ratio * omega, omega * np.sqrt(1.0 - ratio**2))
        columns = np.stack([np.ones(size), driving], axis=1) * (root / (s - pole))[:, None]
        own = np.linalg.qr(columns - basis @ (np.conj(basis.T) @ columns))[0]
        gained = np.sum(np.abs(np.conj(own.T) @ rest) ** 2, axis=0) / left
        gain = -size * float(np.sum(np.log1p(-np.minimum(gained, 1.0 - 1e-12))))
        if omega * samples.span_s > 4.0 * np.pi and gain > best[0]:
            best = (gain, pole)
    return best

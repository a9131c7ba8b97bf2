"""Whether the motion of a mode is stationary: an ambient record that holds a decay is none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, gammainccinv

from modal_id.ambient.spectrum import Spectrum
from tracker import Failure, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Power of blocks."""

    #: [1] probability that a stationary record exceeds the limit
    false_alarm: float = 1e-4
    #: [1] independent values of the power in a block, at least
    #: statistics: The largest of 50 blocks is then below six times the mean.
    least_values: float = 4.0
    #: [blocks] most blocks
    most_blocks: int = 50
    #: [blocks] fewest blocks
    least_blocks: int = 6
    #: [half-widths] of the band
    reach: float = 6.0
    #: [1] share of the power in blocks above the limit from which the record is refused
    #: convention: Below it, the stationary part determines the spectrum.
    share: float = 0.3


TUNING = Tuning()
_NEXT = "identify the decay with excitation = 'free', or cut it out with onset_s and end_s"


def not_stationary(found: Spectrum, frequency_hz: float, damping_ratio: float) -> Failure | None:
    """Why the record is not one of stationary motion; None where it may be.

    The power of a mode in a block of T seconds under a white force has the gamma distribution with about
    ``zeta w T`` independent values, relative to its mean. The mean is that of the record without the strongest blocks.
    """
    rate = 2.0 * np.pi * damping_ratio * frequency_hz
    blocks = int(min(TUNING.most_blocks, found.span_s * rate / TUNING.least_values))
    half = max(TUNING.reach * damping_ratio * frequency_hz, 4.0 / found.span_s)
    inside = np.abs(found.frequency_hz - frequency_hz) < half
    # Amplitude in the band, sampled evenly: the transform back of its frequencies alone.
    band = found.values[inside]
    length = max(band.shape[0], 4 * blocks)
    power = np.sum(np.abs(np.fft.ifft(band, length, axis=0)) ** 2, axis=1)
    if blocks < TUNING.least_blocks:
        return _decays(power, 0.5 * found.span_s * rate, frequency_hz)
    of_block = np.array([np.sum(one) for one in np.array_split(power, blocks)])
    values = found.span_s * rate / blocks
    usual = float(np.median(of_block))
    limit = (
        float(gammainccinv(values, TUNING.false_alarm / blocks))
        / values
        * usual
        * (1.0 + 1.0 / (3.0 * values))
    )
    loud = of_block > limit
    share = float(np.sum(of_block[loud]) / np.sum(of_block))
    if share < TUNING.share:
        return None
    where_s = found.span_s * float(np.argmax(of_block)) / blocks
    return Failure(
        f"the motion at {frequency_hz:.4g} Hz is not stationary: {100.0 * share:.2g} % of its power lie in "
        f"{100.0 * float(np.mean(loud)):.2g} % of the record, most of it from {where_s:.4g} s on, as after a stroke. "
        "An ambient record holds motion under a steady random force",
        next_step=_NEXT,
    )


def _decays(power: FloatArray, values: float, frequency_hz: float) -> Failure | None:
    """Why a record of few blocks is not stationary: the powers of its halves, of `values` independent ones, differ.

    Their ratio has the F distribution with twice as many degrees of freedom.
    """
    first, second = (float(np.sum(one)) for one in np.array_split(power, 2))
    if fdtrc(2.0 * values, 2.0 * values, first / second) > TUNING.false_alarm:
        return None
    return Failure(
        f"the motion at {frequency_hz:.4g} Hz decays: the first half of the record has {first / second:.3g} times the "
        "power of the second. An ambient record holds motion under a steady random force",
        next_step=_NEXT,
    )

"""What the decays of one record are: free motion of the structure, or the same motion held by a hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal_id.results import DecayValue
from modal_id.segments import BETWEEN_SD, held_density


@dataclass(frozen=True)
class Tuning:
    """A decay that is held."""

    #: [1] probability, before it is seen, that a decay after another is held
    held: float = 0.1
    #: [1] relative distance of frequencies within which two decays show the same motion
    #: convention: A hand shifts the frequency, too.
    same: float = 0.05
    #: [1] ratio of amplitudes from which a later decay has the larger one
    #: convention: That of a start located half a cycle early differs by less.
    louder: float = 1.25


TUNING = Tuning()


def held_odds(free: DecayValue, other: DecayValue) -> float:
    """Odds that a decay is held, where `free` is an earlier one of the same motion.

    Parameters
    ----------
    free, other : DecayValue
        Values of one mode in both decays.

    Returns
    -------
    float
        0 where the other decay begins earlier or with a larger amplitude: damping that depends on the amplitude is
        then as likely a cause. A damping ratio that is not positive, and NaN, give 0.

    Notes
    -----
    The logarithm of the ratio of both damping ratios is normal about 0 if both are free, with the scatter of clamps
    that settle; if one is held, it has `held_density`.
    """
    if other.start_s < free.start_s or not other.amplitude < TUNING.louder * free.amplitude:
        return 0.0
    if not min(free.damping_ratio, other.damping_ratio) > 0.0:
        return 0.0
    ratio = float(np.log(other.damping_ratio / free.damping_ratio))
    own = (one.damping_ratio_sd / one.damping_ratio for one in (free, other))
    sd = float(np.linalg.norm([*own, BETWEEN_SD]))
    same = np.exp(-0.5 * (ratio / sd) ** 2) / (sd * np.sqrt(2.0 * np.pi))
    more = held_density(free.damping_ratio, other.damping_ratio)
    odds = TUNING.held / (1.0 - TUNING.held) * more / max(float(same), 1e-300)
    return float(odds) if np.isfinite(odds) else 0.0


def held_decays(values: Sequence[DecayValue]) -> tuple[int, ...]:
    """Indices of the decays that are more probably held than free; `values` are those of the strongest mode of each."""
    found = []
    for k, one in enumerate(values):
        earlier = (free for free in values if abs(free.frequency_hz / one.frequency_hz - 1.0) < TUNING.same)
        if any(held_odds(free, one) > 1.0 for free in earlier):
            found.append(k)
    return tuple(found)

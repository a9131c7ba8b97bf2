"""Whether a motion is driven: the posterior probability from the change of its amplitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, voigt_profile


@dataclass(frozen=True)
class Tuning:
    """Odds of a drive."""

    #: [1] probability of a drive of a steady motion, where nothing else is known
    prior: float = 0.5
    #: [1] the same after the motion jumped: a pluck, or a drive that starts
    after_jump: float = 0.1
    #: [1] half width at half maximum of the change of the logarithm of a drive's amplitude
    drive_change: float = 0.005
    #: [1] sd of the change of the log amplitude above which it tells nothing of a drive
    known: float = 0.1
    #: [1] smallest damping ratio of a structure
    #: physics: That of the least damped metals.
    least_damping: float = 1e-5
    #: [1] largest damping ratio of a motion that oscillates
    most_damping: float = 0.5
    #: [1] least ratio by which a hand increases the damping ratio
    held_ratio: float = 1.5
    #: [1] least damping ratio of a motion that is held
    #: physics: A hand damps by flesh and bone, not by friction in a metal.
    held_least: float = 0.01
    #: [1] largest damping ratio of a motion that is held
    #: physics: Above it there is no oscillation to identify.
    held_most: float = 0.7
    #: [1] sd of the logarithm of the damping ratio between free decays of one structure
    between: float = 0.3
    #: [1] probability of any damping ratio after a free motion, neither its own nor a hand's
    other: float = 0.2
    #: [1] probability from which a part without a decay is called driven
    #: convention: Odds of two to one, because a refusal costs more than a wide interval.
    probable: float = 2.0 / 3.0
    #: [1] probability from which a motion that ends abruptly is called driven
    #: convention: A hand ends a free motion as abruptly.
    stopped: float = 0.8
    #: [1] probability from which a motion without further evidence is called driven
    #: statistics: One motion in 20; below its complement, a motion is called free without doubt.
    sure: float = 0.95


TUNING = Tuning()

# Probabilities of a drive before the change of its amplitude is seen.
PRIOR, PRIOR_AFTER_JUMP = TUNING.prior, TUNING.after_jump
BETWEEN_SD = TUNING.between


def drive_probability(
    change: float, sd: float, radians: float, prior: float = PRIOR, follows: float | None = None
) -> float:
    """Posterior probability that a steady motion is driven.

    Parameters
    ----------
    change : float
        Logarithm of the amplitude at its start over that at its end: positive for a decay.
    sd : float
        Standard deviation of `change`.
    radians : float
        Phase through which the motion turns.
    prior : float
        Probability of a drive before its amplitude is seen.
    follows : float or None
        Damping ratio of the motion at the same frequency after a change, where there is one.

    Returns
    -------
    float
        Between 0 and 1; 0.5 where the change is hardly known, or a value is not finite.

    Notes
    -----
    The change is normal with its standard deviation about 0 for a drive, whose own change has a Cauchy distribution,
    and about ``zeta radians`` for a decay, with the logarithm of zeta uniform between the damping ratios of structures.
    After a drive that stops, the damping ratio is any of a structure. After a free motion it is that of the same
    structure with the scatter between decays, or that of a motion that is held, which are equally likely; or, rarely,
    any: a part that is too short to tell.
    """
    if not np.all(np.isfinite([change, sd, radians])) or not 0.0 < sd < TUNING.known or radians <= 0.0:
        return 0.5
    driven = float(voigt_profile(change, sd, TUNING.drive_change))
    zeta = np.geomspace(TUNING.least_damping, TUNING.most_damping, 400)
    edges, log_range = zeta * radians, float(np.log(TUNING.most_damping / TUNING.least_damping))
    # exact for a density that is constant in each cell, however narrow the normal density is
    mass = np.diff(ndtr((edges - change) / sd)) / np.diff(edges) * np.diff(np.log(edges))
    if follows is not None and follows > 0.0:
        driven /= log_range
        own = np.sqrt(zeta[1:] * zeta[:-1])
        same = np.exp(-0.5 * (np.log(follows / own) / BETWEEN_SD) ** 2) / (BETWEEN_SD * np.sqrt(2.0 * np.pi))
        held = np.array([held_density(one, follows) for one in own.tolist()])
        mass = mass * (0.5 * (1.0 - TUNING.other) * (same + held) + TUNING.other / log_range)
    free = float(np.sum(mass)) / log_range
    return prior * driven / max(prior * driven + (1.0 - prior) * free, 1e-300)


def held_density(free: float, zeta: float) -> float:
    """Probability density of ln zeta of a motion that is held, whose damping ratio is otherwise `free`.

    Uniform up to the largest damping ratio; 0 below that of a hand, or a least ratio to the free one.
    """
    least = max(TUNING.held_ratio * free, TUNING.held_least)
    if not least < zeta < TUNING.held_most:
        return 0.0
    return 1.0 / float(np.log(TUNING.held_most / least))


def is_rather_driven(probability: float) -> bool:
    """Whether a drive is the better explanation of a motion."""
    return probability > 0.5


def is_probably_driven(probability: float) -> bool:
    """Whether a part of a record is called driven, where no decay follows that would tell."""
    return probability > TUNING.probable


def is_driven(probability: float, *, stopped: bool = False) -> bool:
    """Whether a motion with this probability is driven beyond doubt, or probably, where it is stopped abruptly."""
    return probability > (TUNING.stopped if stopped else TUNING.sure)


def may_be_driven(probability: float) -> bool:
    """Whether a motion with this probability is not free beyond doubt."""
    return probability > 1.0 - TUNING.sure

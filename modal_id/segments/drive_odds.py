"""Whether a motion is driven: the posterior probability from the change of its amplitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, voigt_profile

from modal_id.data import BEYOND_SD, FitData, rough_variance
from modal_id.fit import ModalFit, find_modes
from modal_id.solve import PoleFit, Problem, damping_ratio, fit_poles, frequency_hz
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Odds of a drive, and steady motion."""

    #: [1] probability of a drive of a steady motion, where nothing else is known
    prior: float = 0.5
    #: [1] the same after the motion jumped: a pluck, or a drive that starts
    after_jump: float = 0.1
    #: [1] the same of a weaker motion beside one that decays: a drift, a hum
    #: convention: Of 263 such motions of 2000 random records that lost less than 40 % of their amplitude, 4 were drift;
    #: films have hums as well.
    beside_a_decay: float = 0.1
    #: [1] half width at half maximum of the change of the logarithm of a drive's amplitude
    #: convention: Half a percent, as of a drive by hand or one that settles.
    drive_change: float = 0.005
    #: [1] the same of a steady drive, such as a generator's; both are equally likely
    #: measurement: With one width, 3 of 21 short drives before a damping ratio of 0.01 are called free (decision 0024).
    steady_change: float = 0.0005
    #: [1] probability that a drive grows: it is tuned, or beats with the transient of its start
    #: measurement: 20 of 72 public records of driven motion grow by 0.04 to 0.5.
    drive_grows: float = 0.2
    #: [1] probability that a free motion grows: modes that beat
    #: measurement: Of 166 free motions of random records three grow by 0.1 to 0.4 (`benchmarks.records`).
    grows: float = 0.02
    #: [1] sd of the growth of the logarithm of its amplitude
    #: measurement: As above.
    other_growth: float = 0.3
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
    #: [1] probability, before it is seen, that a decay after another is held
    #: measurement: Of 45 decays after a doubtful drive five are held, and six by their probabilities (decision 0063).
    hand: float = 0.1
    #: [1] ratio of amplitudes from which a later decay has the larger one
    #: convention: That of a start located half a cycle early differs by less.
    louder: float = 1.25
    #: [1] sd of the logarithm of the damping ratio between free decays of one structure
    between: float = 0.3
    #: [1] probability of any damping ratio after a free motion, neither its own nor a hand's
    #: convention: What follows may be several motions; a drive of one decay before a hand is called so without it
    #: (seed 13775 of `benchmarks.records`).
    other: float = 0.1
    #: [1] probability from which a part without a decay is called driven
    #: measurement: With one half, a tuning fork filmed for 0.25 s is called driven (decision 0056).
    probable: float = 2.0 / 3.0
    #: [1] probability of a free decay below which a motion is flagged as perhaps driven
    #: statistics: One motion in 20.
    sure: float = 0.95
    #: [1] largest number of modes of the fit
    modes: int = 4
    #: [1] relative distance from the frequency looked for within which a line is the dominant one
    same_line: float = 0.05
    #: [1] amplitude over the strongest from which a line must be steady
    strong: float = 0.2
    #: [1] fall of the log amplitude from which it decays
    decayed: float = 0.5
    #: [beats] modes with fewer beats in the record are close
    #: physics: One mode whose amplitude changes may imitate them.
    close_beats: float = 4.0
    #: [1] share of the power that the fit of a free decay may leave
    most_left: float = 0.05
    #: [1] share from which the fit tells nothing of a drive
    unexplained: float = 0.3


TUNING = Tuning()


# Probabilities of a drive before the change of its amplitude is seen.
PRIOR, PRIOR_AFTER_JUMP, PRIOR_BESIDE_A_DECAY = TUNING.prior, TUNING.after_jump, TUNING.beside_a_decay
BETWEEN_SD, LOUDER = TUNING.between, TUNING.louder
HAND, HELD_LEAST = TUNING.hand, TUNING.held_least


class Roles(NamedTuple):
    """Probabilities of what a motion is, and what the motion after it is: both free, a drive before, a hand after."""

    free: float
    driven: float
    held: float

    @property
    def likeliest(self) -> str:
        """Name of the most probable."""
        return self._fields[int(np.argmax(self))]


def roles_of(
    change: float,
    sd: float,
    radians: float,
    prior: float = PRIOR,
    after: tuple[float, float] | None = None,
) -> Roles:
    """What a motion is, from the change of its amplitude and from the damping ratio of the motion that follows.

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
    after : tuple of (float, float), or None
        Damping ratio of the same motion afterwards, with its standard deviation; above 0.

    Returns
    -------
    Roles
        `prior` for the drive where `change`, its standard deviation or `radians` is not finite. At most `prior`,
        without what follows, where the change is hardly known.

    Notes
    -----
    The change is normal with its standard deviation about 0 for a drive, whose own change has a Cauchy distribution,
    and about ``zeta radians`` for a decay, with the logarithm of zeta uniform between the damping ratios of structures.
    Either may grow, a drive more often than a free motion. After a drive, or a motion that grows, the damping ratio is
    any of a structure; after another free motion, that of the same structure with the scatter between decays, or that
    of a motion that is held, with the logarithm uniform above a least ratio to the free one and that of a hand, or,
    rarely, any: it may be several motions.
    """
    if not (np.all(np.isfinite([change, sd, radians])) and sd > 0.0 and radians > 0.0):
        return Roles(1.0 - prior, prior, 0.0)
    widths = np.array([TUNING.drive_change, TUNING.steady_change])
    driven = float(np.mean(voigt_profile(change, sd, widths)))
    wide = float(np.hypot(sd, TUNING.other_growth))
    # the normal density of a growth, of which noise hides a part
    grown = 2.0 * float(np.exp(-0.5 * (change / wide) ** 2)) / (wide * np.sqrt(2.0 * np.pi))
    grown *= float(ndtr(-change * TUNING.other_growth / (sd * wide)))
    zeta = np.geomspace(TUNING.least_damping, TUNING.most_damping, 400)
    edges, log_range = zeta * radians, float(np.log(TUNING.most_damping / TUNING.least_damping))
    # exact for a density that is constant in each cell, however narrow the normal density is
    mass = np.diff(ndtr((edges - change) / sd)) / np.diff(edges) * np.diff(np.log(edges)) / log_range
    driven = (1.0 - TUNING.drive_grows) * driven + TUNING.drive_grows * grown
    free = (1.0 - TUNING.grows) * float(np.sum(mass)) + TUNING.grows * grown
    if sd > TUNING.known:
        # A change that is hardly known may tell of a decay, but not of a drive.
        driven = min(driven, free)
    held = 0.0
    if after is not None:
        own = np.sqrt(zeta[1:] * zeta[:-1])
        spread = float(np.hypot(TUNING.between, after[1] / after[0]))
        same = np.exp(-0.5 * (np.log(after[0] / own) / spread) ** 2) / (spread * np.sqrt(2.0 * np.pi))
        mass *= 1.0 - TUNING.grows
        held = (1.0 - TUNING.other) * TUNING.hand * float(mass @ _held_density(own, after[0]))
        known = (1.0 - TUNING.other) * (1.0 - TUNING.hand) * same + TUNING.other / log_range
        free = float(mass @ known) + TUNING.grows * grown / log_range
        driven /= log_range
    weights = np.array([(1.0 - prior) * free, prior * driven, (1.0 - prior) * held])
    return Roles(*(weights / max(float(np.sum(weights)), 1e-300)).tolist())


def _held_density(free: FloatArray, zeta: float) -> FloatArray:
    """Probability density of ln zeta of a motion that is held, whose damping ratio is otherwise `free`.

    Uniform up to the largest damping ratio; 0 below that of a hand, or a least ratio to the free one.
    """
    least = np.maximum(TUNING.held_ratio * free, TUNING.held_least)
    if zeta >= TUNING.held_most:
        return np.zeros_like(free)
    return np.where(least < zeta, 1.0 / np.log(TUNING.held_most / np.minimum(least, zeta)), 0.0)


def is_rather_driven(probability: float) -> bool:
    """Whether a drive is the better explanation of a motion."""
    return probability > 0.5


def is_driven_part(probability: float) -> bool:
    """Whether a part of a record is called driven, where no decay follows that would tell."""
    return probability > TUNING.probable


def may_be_driven(probability: float) -> bool:
    """Whether a motion with this probability is not free beyond doubt."""
    return probability > 1.0 - TUNING.sure


def probability_of_drive(
    data: FitData, line_hz: float, lowest_hz: float, prior: float, follows: FitData | None = None
) -> float:
    """Probability that the line at this frequency is driven, from the change of its amplitude over the data.

    All modes are fitted, because the residual of a weaker mode would hide a slow decay. 0 where the fit fails.
    `follows` is the motion after a change.
    """
    data, fit, index = _line(data, line_hz, lowest_hz)
    if not fit.converged:
        return 0.0
    if _left(data, fit) > TUNING.unexplained:
        # Where free decays do not explain the motion, the pole of one of them is no evidence.
        return prior
    after = None if follows is None else _damping(*_line(follows, line_hz, lowest_hz))
    pole, span_s = complex(fit.poles[index]), data.span_s
    sd = _rate_sd(data, fit, index)
    return roles_of(-pole.real * span_s, sd * span_s, abs(pole) * span_s, prior, after).driven


def _damping(data: FitData, fit: PoleFit, index: int) -> tuple[float, float] | None:
    """Damping ratio and its standard deviation, where there is one."""
    zeta = float(damping_ratio(complex(fit.poles[index])))
    return (
        (zeta, _rate_sd(data, fit, index) / abs(fit.poles[index])) if fit.converged and zeta > 0.0 else None
    )


def decays(data: FitData, line_hz: float, lowest_hz: float) -> bool:
    """Whether the line at this frequency decays significantly, and free decays leave little beside it."""
    data, fit, index = _line(data, line_hz, lowest_hz)
    decays_ = -float(fit.poles[index].real) > BEYOND_SD * _rate_sd(data, fit, index)
    return fit.converged and decays_ and _left(data, fit) < TUNING.most_left


def _left(data: FitData, fit: PoleFit) -> float:
    """Share of the power of the motion that a fit leaves beyond noise."""
    centred = data.values - np.mean(data.values, axis=0)
    left = float(np.sum(np.maximum(fit.linear.rss - rough_variance(data) * data.counts, 0.0)))
    return left / max(float(np.sum(data.weights * centred**2)), 1e-300)


def _line(data: FitData, line_hz: float, lowest_hz: float) -> tuple[FitData, PoleFit, int]:
    """Fit of all modes, or of one, and the index of the mode at this frequency."""
    model = find_modes(data, TUNING.modes, lowest_hz)
    if model is not None:
        distance = np.abs(frequency_hz(model.fit.poles) / line_hz - 1.0)
        index = int(np.argmin(distance))
        if distance[index] < TUNING.same_line:
            return model.data, model.fit, index
    start = np.array([-1e-3 / max(data.span_s, 1e-9) + 2j * np.pi * line_hz])
    return data, fit_poles(Problem(data, np.ones((data.time_s.size, 1))), start), 0


def holds_a_decay(model: ModalFit) -> bool:
    """Whether one of the stronger modes of a fit decays significantly, to less than two thirds.

    Close modes, resolved or not, are one driven motion whose amplitude changes.
    """
    fit = model.fit
    strength = np.max(np.abs(fit.linear.amplitudes), axis=1)
    hz = frequency_hz(fit.poles)
    close = np.abs(hz[:, None] - hz) < TUNING.close_beats / model.data.span_s
    alone = np.count_nonzero(close, axis=1) == 1
    alone &= [model.unresolved_near(index) is None for index in range(alone.size)]
    for index in np.flatnonzero(alone & (strength > TUNING.strong * np.max(strength))).tolist():
        rate, sd = -float(fit.poles[index].real), _rate_sd(model.data, fit, index)
        if rate * model.data.span_s > TUNING.decayed and rate > BEYOND_SD * sd:
            return True
    return False


def _rate_sd(data: FitData, fit: PoleFit, index: int) -> float:
    """Standard deviation of a mode's rate, 1/s, for the noise beside its line, at least white."""
    centre = float(fit.poles[index].imag) / (2.0 * np.pi)
    aside = np.array([-6.5, -5.5, -4.5, -3.5, -2.5, 2.5, 3.5, 4.5, 5.5, 6.5]) / max(data.span_s, 1e-300)
    waves = np.exp(-2j * np.pi * (centre + aside)[:, None] * data.time_s)
    power = np.mean(np.abs(waves @ (data.weights * fit.linear.residual)) ** 2, axis=0)
    white = np.maximum(fit.linear.noise_variance * np.sum(data.weights**2, axis=0), 1e-300)
    return float(fit.pole_sd[index, 0]) * float(np.sqrt(max(float(np.max(power / white)), 1.0)))

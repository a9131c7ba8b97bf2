"""Whether a motion is driven: the posterior probability from the change of its amplitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, voigt_profile

from modal_id.data import BEYOND_SD, FitData, rough_variance
from modal_id.fit import ModalFit, find_modes
from modal_id.mode_values import DecayValue
from modal_id.solve import PoleFit, Problem, damping_ratio, fit_poles, frequency_hz
from tracker import BoolArray


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
    other: float = 0.2
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
BETWEEN_SD, HELD_LEAST = TUNING.between, TUNING.held_least


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
        Between 0 and 1; at most 0.5 where the change is hardly known, 0.5 where a value is not finite.

    Notes
    -----
    The change is normal with its standard deviation about 0 for a drive, whose own change has a Cauchy distribution,
    and about ``zeta radians`` for a decay, with the logarithm of zeta uniform between the damping ratios of structures.
    After a drive that stops, the damping ratio is any of a structure. After a free motion it is that of the same
    structure with the scatter between decays, or that of a motion that is held; or, rarely, any: a part that is too
    short to tell. Either may grow, a drive more often than a free motion.
    """
    if not (np.all(np.isfinite([change, sd, radians])) and sd > 0.0 and radians > 0.0):
        return 0.5
    widths = np.array([TUNING.drive_change, TUNING.steady_change])
    driven = float(np.mean(voigt_profile(change, sd, widths)))
    wide = float(np.hypot(sd, TUNING.other_growth))
    other = 2.0 * float(np.exp(-0.5 * (change / wide) ** 2)) / (wide * np.sqrt(2.0 * np.pi))
    # the normal density of a growth, of which noise hides a part
    other *= float(ndtr(-change * TUNING.other_growth / (sd * wide)))
    zeta = np.geomspace(TUNING.least_damping, TUNING.most_damping, 400)
    edges, log_range = zeta * radians, float(np.log(TUNING.most_damping / TUNING.least_damping))
    # exact for a density that is constant in each cell, however narrow the normal density is
    mass = np.diff(ndtr((edges - change) / sd)) / np.diff(edges) * np.diff(np.log(edges))
    if follows is not None and follows > 0.0:
        driven, other = driven / log_range, other / log_range
        own = np.sqrt(zeta[1:] * zeta[:-1])
        same = np.exp(-0.5 * (np.log(follows / own) / BETWEEN_SD) ** 2) / (BETWEEN_SD * np.sqrt(2.0 * np.pi))
        held = np.array([held_density(one, follows) for one in own.tolist()])
        known = (1.0 - TUNING.hand) * same + TUNING.hand * held
        mass = mass * ((1.0 - TUNING.other) * known + TUNING.other / log_range)
    free = (1.0 - TUNING.grows) * float(np.sum(mass)) / log_range + TUNING.grows * other
    driven = (1.0 - TUNING.drive_grows) * driven + TUNING.drive_grows * other
    odds = prior * driven / max(prior * driven + (1.0 - prior) * free, 1e-300)
    # A change that is hardly known may tell of a decay, but not of a drive.
    return float(odds if sd < TUNING.known else min(odds, 0.5))


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
    later = None
    if follows is not None:
        _, after, line = _line(follows, line_hz, lowest_hz)
        later = float(damping_ratio(complex(after.poles[line]))) if after.converged else None
    return _probability(data, fit, index, prior, later)


def decays(data: FitData, line_hz: float, lowest_hz: float) -> bool:
    """Whether the line at this frequency decays significantly, and free decays leave little beside it."""
    data, fit, index = _line(data, line_hz, lowest_hz)
    sd = float(fit.pole_sd[index, 0]) * _noise_factor(data, fit, index)
    decays_ = -float(fit.poles[index].real) > BEYOND_SD * sd
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


def close_modes(model: ModalFit) -> BoolArray:
    """Which modes of a fit are close to each other, and to themselves; shape (modes, modes)."""
    hz = frequency_hz(model.fit.poles)
    return np.asarray(np.abs(hz[:, None] - hz) < TUNING.close_beats / model.data.span_s)


def holds_a_decay(model: ModalFit) -> bool:
    """Whether one of the stronger modes of a fit decays significantly, to less than two thirds.

    Close modes, resolved or not, are one driven motion whose amplitude changes.
    """
    fit = model.fit
    strength = np.max(np.abs(fit.linear.amplitudes), axis=1)
    alone = np.count_nonzero(close_modes(model), axis=1) == 1
    alone &= [model.unresolved_near(index) is None for index in range(alone.size)]
    for index in np.flatnonzero(alone & (strength > TUNING.strong * np.max(strength))).tolist():
        rate, sd = -float(fit.poles[index].real), float(fit.pole_sd[index, 0])
        if rate * model.data.span_s > TUNING.decayed and rate > BEYOND_SD * sd * _noise_factor(
            model.data, fit, index
        ):
            return True
    return False


def _probability(data: FitData, fit: PoleFit, index: int, prior: float, follows: float | None) -> float:
    if _left(data, fit) > TUNING.unexplained:
        # Where free decays do not explain the motion, the pole of one of them is no evidence.
        return prior
    pole, span_s = complex(fit.poles[index]), data.span_s
    sd = float(fit.pole_sd[index, 0]) * _noise_factor(data, fit, index)
    return drive_probability(-pole.real * span_s, sd * span_s, abs(pole) * span_s, prior, follows)


def _noise_factor(data: FitData, fit: PoleFit, index: int) -> float:
    """Residual spectrum beside the line relative to white noise, as a factor on standard deviations, at least 1."""
    centre = float(fit.poles[index].imag) / (2.0 * np.pi)
    aside = np.array([-6.5, -5.5, -4.5, -3.5, -2.5, 2.5, 3.5, 4.5, 5.5, 6.5]) / max(data.span_s, 1e-300)
    waves = np.exp(-2j * np.pi * (centre + aside)[:, None] * data.time_s)
    power = np.mean(np.abs(waves @ (data.weights * fit.linear.residual)) ** 2, axis=0)
    white = np.maximum(fit.linear.noise_variance * np.sum(data.weights**2, axis=0), 1e-300)
    return float(np.sqrt(max(float(np.max(power / white)), 1.0)))


class PairRoles(NamedTuple):
    """Probabilities of what two decays of one motion are: free both, the earlier one a drive, the later one held."""

    free: float
    earlier_driven: float
    later_held: float


def pair_roles(earlier: DecayValue, later: DecayValue, driven: float) -> PairRoles:
    """What two decays of one motion are, from their damping ratios.

    Parameters
    ----------
    earlier, later : DecayValue
        Values of one mode in both decays.
    driven : float
        Probability that the earlier one is driven before the later one is seen.

    Returns
    -------
    PairRoles
        Both free where the order is another, or the amplitude of the later one is larger: damping that depends on the
        amplitude is then as likely a cause. So, too, where the later damping ratio is not positive, and for NaN.

    Notes
    -----
    The logarithm of the ratio of both damping ratios is normal about 0 if both are free, with the scatter of clamps
    that settle; if the later one is held, it has `held_density`. After a drive, any damping ratio is as likely.
    """
    after = later.start_s >= earlier.start_s and later.amplitude < TUNING.louder * earlier.amplitude
    if not (after and later.damping_ratio > 0.0):
        return PairRoles(1.0, 0.0, 0.0)
    # a motion that grows has a damping ratio within its error at most
    own = max(earlier.damping_ratio, earlier.damping_ratio_sd, TUNING.least_damping)
    ratio = float(np.log(later.damping_ratio / own))
    errors = earlier.damping_ratio_sd / own, later.damping_ratio_sd / later.damping_ratio
    sd = float(np.linalg.norm([*errors, TUNING.between]))
    same = float(np.exp(-0.5 * (ratio / sd) ** 2)) / (sd * np.sqrt(2.0 * np.pi))
    more = held_density(own, later.damping_ratio)
    drives = driven / float(np.log(TUNING.most_damping / TUNING.least_damping))
    weights = np.array([(1.0 - TUNING.hand) * same, 0.0, TUNING.hand * more]) * (1.0 - driven) + [
        0.0,
        drives,
        0.0,
    ]
    total = float(np.sum(weights))
    return PairRoles(*(weights / total).tolist()) if total > 0.0 else PairRoles(1.0, 0.0, 0.0)

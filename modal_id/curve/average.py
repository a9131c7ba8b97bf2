"""The curve of a mode: laws of decay fitted to its blocks, and their average weighted by evidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.curve.law_fit import LawFit
from modal_id.curve.laws import CONSTANT, PowerLaw, SaturatingLaw, SplineLaw, StiffnessLaw
from modal_id.curve.track import ANGULAR_CHANGE, DECAY_CHANGE, Track, follow
from modal_id.fit import ModalFit, own_decay
from modal_id.results import AmplitudeCurve
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Laws of the damping and their average."""

    #: [1] log odds against a law from which it is left out of the average
    #: physics: exp(-40) of the weight.
    negligible: float = 40.0
    #: [1] number of points of the amplitude curve
    points: int = 41
    #: [1] residual power over the noise up to which a law is adequate
    adequate: float = 1.5
    #: [1] residual power over the noise from which a law is inadequate
    inadequate: float = 2.5
    #: [1] residual power over that of constant values below which a law explains their misfit in any case
    mostly_explained: float = 0.01
    #: [1] smallest amplitude of the curve over the largest above which no decade of amplitudes is seen
    #: convention: A tenth.
    decade: float = 0.1


TUNING = Tuning()
_ADEQUATE = TUNING.adequate

# Prior sds of the changes over all amplitudes, relative to decay rate and frequency, over which splines and laws of
# stiffness alone are averaged; of the others, the largest.
_DECAY_SCALES = (0.1, 0.4, DECAY_CHANGE)
_ANGULAR_SCALES = (1e-4, 5e-4, 2.5e-3, ANGULAR_CHANGE)
# Starting values of the powers of a saturating law.
_POWERS = (2.0, 4.0)


def explains(curve: AmplitudeCurve, limit: float = _ADEQUATE) -> bool:
    """Whether a curve leaves less than `limit` times the noise at the mode, or a small part of what constants leave."""
    return curve.residual_power < max(limit, TUNING.mostly_explained * curve.constant_residual_power)


def is_one_curve(curve: AmplitudeCurve | None) -> bool:
    """Whether one mode with any dependence on amplitude explains the motion over a decade of amplitudes.

    Over a smaller range, a curve may imitate part of a beat.
    """
    return curve is not None and curve.amplitude[1] <= TUNING.decade * curve.amplitude[-1] and explains(curve)


def amplitude_curve(model: ModalFit, mode: int, own: ModalFit | None = None) -> AmplitudeCurve | None:
    """Curve of the mode with this index; None where the record is too short or too noisy for it.

    `own` is the mode's `own_decay`, where it is known.

    The most probable law is chosen with the noise level of the residual of a spline. All laws are then compared with
    the noise level of the residual of this law, so that its misfit counts as noise.
    """
    found = follow(own_decay(model, mode) if own is None else own)
    if found is None:
        return None
    track, flexible = found
    constant = track.fit(PowerLaw((), 1.0, 1.0), np.array([track.decay, track.angular]))
    if flexible is None and constant is None:
        return None
    fits = _all_fits(track, flexible, constant)
    best = max(fits, key=_log_weight)
    final = track.with_noise_around(best[1])
    again = [(prior, final.fit(fit.law, fit.parameters)) for prior, fit in fits if _near(best, (prior, fit))]
    fits = [(prior, fit) for prior, fit in again if fit is not None] or [best]
    weights = np.exp(np.array([_log_weight(fit) for fit in fits]) - max(map(_log_weight, fits)))
    weights /= np.sum(weights)
    probability: dict[str, float] = {}
    for weight, (_, fit) in zip(weights, fits, strict=True):
        probability[fit.law.name] = probability.get(fit.law.name, 0.0) + float(weight)
    law = max(probability, key=lambda name: probability[name])
    laws = [fit for _, fit in fits]
    amplitude = np.concatenate([[0.0], np.geomspace(min(track.lowest, 0.95), 1.0, TUNING.points - 1)])
    left = track.residual_power(best[1])
    doubt = float(np.clip((left - TUNING.adequate) / (TUNING.inadequate - TUNING.adequate), 0.0, 1.0))
    decay, decay_sd = _mixture(weights, laws, amplitude, 0, doubt)
    angular, angular_sd = _mixture(weights, laws, amplitude, 1, doubt)
    omega = np.hypot(decay, angular)
    start = float(np.max(np.abs(model.fit.linear.amplitudes[mode]))) * abs(best[1].initial)
    return AmplitudeCurve(
        amplitude=amplitude * start,
        damping_ratio=decay / omega,
        damping_ratio_sd=decay_sd / omega,
        frequency_hz=omega / (2.0 * np.pi),
        frequency_sd_hz=angular_sd / (2.0 * np.pi),
        law=law,
        constant_probability=probability.get(CONSTANT, 0.0),
        residual_power=left,
        constant_residual_power=float("nan") if constant is None else track.residual_power(constant),
    )


def _log_weight(fit: tuple[float, LawFit]) -> float:
    """Logarithm of the posterior probability of a law, up to a constant, from (its logarithmic prior, its fit)."""
    return fit[0] + fit[1].log_evidence


def _near(best: tuple[float, LawFit], fit: tuple[float, LawFit]) -> bool:
    return _log_weight(best) - _log_weight(fit) < TUNING.negligible


def _all_fits(track: Track, flexible: LawFit | None, constant: LawFit | None) -> list[tuple[float, LawFit]]:
    """(logarithm of the prior probability, fit) of each law; the scales of a law share one probability.

    Constant rates only where the spline could not be fitted: no law describes the motion then.
    """
    found: list[tuple[float, LawFit | None]] = [(0.0, constant)]
    if flexible is None:
        return [(prior, fit) for prior, fit in found if fit is not None]
    spline = flexible.law
    assert isinstance(spline, SplineLaw)  # noqa: S101 - `follow` fits no other
    at = spline.rates(spline.knot_amplitudes, flexible.parameters)
    decay_sd, angular_sd = DECAY_CHANGE * track.decay, ANGULAR_CHANGE * track.angular
    change = [float(at.decay[-1] - at.decay[1]), float(at.angular[-1] - at.angular[1])]
    small = [float(at.decay[1]), float(at.angular[1])]
    for powers in ((1.0, 2.0), (1.0, 1.0), (2.0, 2.0)):
        law = PowerLaw(powers, decay_sd, angular_sd)
        found.append((0.0, track.fit(law, np.array(small + change))))
    start = np.array([*small, change[1]])
    scales = [StiffnessLaw(scale * track.angular) for scale in _ANGULAR_SCALES[1:]]
    found += [(-float(np.log(len(scales))), track.fit(law, start)) for law in scales]
    saturating = SaturatingLaw(decay_sd, angular_sd, track.lowest)
    crossing = [_crossing(spline.knot_amplitudes, rate) for rate in (at.decay, at.angular)]
    tried = [
        track.fit(saturating, np.array([*small, *change, *np.log(crossing), *np.log([power, power])]))
        for power in _POWERS
    ]
    good = [fit for fit in tried if fit is not None]
    if good:
        found.append((0.0, max(good, key=lambda fit: fit.log_evidence)))
    found += _splines(track, flexible)
    return [(prior, fit) for prior, fit in found if fit is not None] or [(0.0, flexible)]


def _splines(track: Track, flexible: LawFit) -> list[tuple[float, LawFit | None]]:
    """Splines with each scale of the changes of damping, then, with the best of these, each of those of frequency."""
    prior = -float(np.log(len(_DECAY_SCALES) * len(_ANGULAR_SCALES)))
    first = [(d, track.fit(track.spline(d, _ANGULAR_SCALES[-1]), flexible.parameters)) for d in _DECAY_SCALES]
    good = [(fit.log_evidence, d) for d, fit in first if fit is not None]
    scale = max(good)[1] if good else _DECAY_SCALES[-1]
    second = [track.fit(track.spline(scale, a), flexible.parameters) for a in _ANGULAR_SCALES[:-1]]
    return [(prior, fit) for fit in [*(fit for _, fit in first), *second]]


def _crossing(amplitude: FloatArray, rate: FloatArray) -> float:
    """Amplitude at which the rate is half way between its first and last value."""
    share = np.abs((rate - rate[0]) / (rate[-1] - rate[0] + 1e-300) - 0.5)
    return float(max(amplitude[np.argmin(share[1:]) + 1], 1e-6))


def _mixture(
    weights: FloatArray, fits: list[LawFit], amplitude: FloatArray, which: int, doubt: float
) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of the decay rate (0) or the angular frequency (1) over the laws.

    Where the laws are not adequate, with `doubt` from 0 to 1, the change that they extrapolate below the lowest
    amplitude is as uncertain as it is large.
    """
    values, variances = np.zeros((2, len(fits), amplitude.size))
    for row, fit in enumerate(fits):
        values[row], slopes = _rate(fit, amplitude, which)
        variances[row] = _variance(slopes, fit.covariance)
        if isinstance(fit.law, SplineLaw):
            # Below the lowest amplitude the data do not determine a spline: from there to zero, a law such as
            # a / (a + s) changes by up to twice as much as while the amplitude doubles.
            low, low_slopes = _rate(fit, np.array([1.0, 2.0]) * amplitude[1], which)
            change = (low[1] - low[0]) ** 2 + _variance(low_slopes[1:] - low_slopes[:1], fit.covariance)[0]
            variances[row, 0] += 4.0 * change
        else:
            variances[row, 0] += doubt * (values[row, 0] - values[row, 1]) ** 2
    mean = weights @ values
    return mean, np.sqrt(weights @ (variances + (values - mean) ** 2))


def _rate(fit: LawFit, amplitude: FloatArray, which: int) -> tuple[FloatArray, FloatArray]:
    rates = fit.law.rates(amplitude, fit.parameters)
    return (rates.decay, rates.decay_slopes) if which == 0 else (rates.angular, rates.angular_slopes)


def _variance(slopes: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("pi,ij,pj->p", slopes, covariance, slopes))

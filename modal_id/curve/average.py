"""The curve of a mode: laws of decay fitted to its blocks, and their average weighted by evidence."""

from __future__ import annotations

import numpy as np

from modal_id.curve.law_fit import LawFit
from modal_id.curve.laws import CONSTANT, PowerLaw, SaturatingLaw, SplineLaw
from modal_id.curve.track import ANGULAR_CHANGE, DECAY_CHANGE, Track, follow
from modal_id.fit.model_order import ModalFit
from modal_id.results import AmplitudeCurve
from tracker.arrays import FloatArray

# Prior standard deviations of the changes of decay rate and frequency over all amplitudes, relative to the rates.
_DECAY_CHANGE = 2.0
_ANGULAR_CHANGE = 0.02
# The same for splines: their scale is averaged over.
_DECAY_SCALES = (0.1, 0.4, DECAY_CHANGE)
_ANGULAR_SCALES = (1e-4, 5e-4, 2.5e-3, ANGULAR_CHANGE)
# Logarithm of the odds against a law that is left out of the average.
_NEGLIGIBLE = 40.0
_POINTS = 41
# Residual power, relative to the noise, up to which a law describes the data.
_ADEQUATE = 2.0
# Powers of a saturating law that its fit starts from.
_POWERS = (2.0, 4.0)


def amplitude_curve(model: ModalFit, mode: int) -> AmplitudeCurve | None:
    """Curve of the mode with this index; None where the record is too short or too noisy for it.

    The noise is first that around a spline, which chooses the most probable law; then that around this law, so that
    what it leaves counts as noise.
    """
    found = follow(model, mode)
    if found is None:
        return None
    track, flexible = found
    constant = track.fit(PowerLaw((), 1.0, 1.0), np.array([track.decay, track.angular]))
    if flexible is None and constant is None:
        return None
    fits = _all_fits(track, flexible, constant)
    best = max(fits, key=_weight)
    final = track.with_noise_around(best[1])
    again = [(prior, final.fit(fit.law, fit.parameters)) for prior, fit in fits if _near(best, (prior, fit))]
    fits = [(prior, fit) for prior, fit in again if fit is not None] or [best]
    chances = np.exp(np.array([_weight(fit) for fit in fits]) - max(map(_weight, fits)))
    chances /= np.sum(chances)
    probability: dict[str, float] = {}
    for chance, (_, fit) in zip(chances, fits, strict=True):
        probability[fit.law.name] = probability.get(fit.law.name, 0.0) + float(chance)
    law = max(probability, key=lambda name: probability[name])
    laws = [fit for _, fit in fits]
    amplitude = np.concatenate([[0.0], np.geomspace(min(track.lowest, 0.95), 1.0, _POINTS - 1)])
    left = track.residual_power(best[1])
    decay, decay_sd = _mixture(chances, laws, amplitude, 0, adequate=left < _ADEQUATE)
    angular, angular_sd = _mixture(chances, laws, amplitude, 1, adequate=left < _ADEQUATE)
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


def _weight(fit: tuple[float, LawFit]) -> float:
    return fit[0] + fit[1].log_evidence


def _near(best: tuple[float, LawFit], fit: tuple[float, LawFit]) -> bool:
    return _weight(best) - _weight(fit) < _NEGLIGIBLE


def _all_fits(track: Track, flexible: LawFit | None, constant: LawFit | None) -> list[tuple[float, LawFit]]:
    """(logarithm of the prior probability, fit) of each law; the scales of the spline share one probability.

    Only constant rates where the spline does not fit: the motion is then no decay by any law.
    """
    found: list[tuple[float, LawFit | None]] = [(0.0, constant)]
    if flexible is None:
        return [(prior, fit) for prior, fit in found if fit is not None]
    spline = flexible.law
    assert isinstance(spline, SplineLaw)  # noqa: S101 - `follow` fits no other
    at = spline.rates(spline.knot_amplitudes, flexible.parameters)
    decay_sd, angular_sd = _DECAY_CHANGE * track.decay, _ANGULAR_CHANGE * track.angular
    change = [float(at.decay[-1] - at.decay[1]), float(at.angular[-1] - at.angular[1])]
    small = [float(at.decay[1]), float(at.angular[1])]
    for powers in ((1.0, 2.0), (1.0, 1.0)):
        law = PowerLaw(powers, decay_sd, angular_sd)
        found.append((0.0, track.fit(law, np.array(small + change))))
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
    """Splines with changes of damping and of frequency of every scale: first the one, then the other."""
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
    chances: FloatArray, fits: list[LawFit], amplitude: FloatArray, which: int, *, adequate: bool
) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of the decay rate (0) or the angular frequency (1) over the laws.

    A law that is not adequate where there are data may change by twice as much below them, or not at all.
    """
    values, variances = np.zeros((2, len(fits), amplitude.size))
    for row, fit in enumerate(fits):
        values[row], slopes = _rate(fit, amplitude, which)
        variances[row] = _variance(slopes, fit.covariance)
        if isinstance(fit.law, SplineLaw):
            # A spline says little below the lowest amplitude: from there to zero, a law such as a / (a + s) changes by
            # up to twice what it does while the amplitude doubles.
            low, low_slopes = _rate(fit, np.array([1.0, 2.0]) * amplitude[1], which)
            change = (low[1] - low[0]) ** 2 + _variance(low_slopes[1:] - low_slopes[:1], fit.covariance)[0]
            variances[row, 0] += 4.0 * change
        elif not adequate:
            variances[row, 0] += (values[row, 0] - values[row, 1]) ** 2
    mean = chances @ values
    return mean, np.sqrt(chances @ (variances + (values - mean) ** 2))


def _rate(fit: LawFit, amplitude: FloatArray, which: int) -> tuple[FloatArray, FloatArray]:
    rates = fit.law.rates(amplitude, fit.parameters)
    return (rates.decay, rates.decay_slopes) if which == 0 else (rates.angular, rates.angular_slopes)


def _variance(slopes: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("pi,ij,pj->p", slopes, covariance, slopes))

"""Number of modes in a band, by the evidence for one more."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import logit

from modal_id.ambient.model import (
    MOST_MODES,
    WIDEST,
    BandData,
    BandFit,
    BandModel,
    fit_band,
    log_likelihood,
    responses,
    spectrum,
)
from modal_id.fit import PLACES
from modal_id.modes import DECIDED
from modal_id.response import PROMISING
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Evidence of a mode."""

    #: [1] ratio of the first guesses of a damping ratio, of which that of the peak is the middle one
    #: physics: The width of a peak may be that of a lobe of noise.
    widths: float = 4.0
    #: [half-widths] largest distance of two modes from the one that they replace
    #: physics: Modes that are further apart have peaks of their own.
    pair_reach: float = 4.0
    #: [half-widths] smaller of the two half-widths tried for two modes in place of one
    #: physics: One mode fitted to two is wider than either.
    pair_width: float = 0.5
    #: [sd] misfit of one mode from which two are tried in its place
    #: statistics: One mode exceeds it in one band of six. A pair that the evidence accepts gains at least 25 in log
    #: likelihood: 50 in chi-square, whose sd is 15 to 50, so that it has a misfit of 1 to 3 at least.
    pair_misfit: float = 1.0
    #: [bins] frequencies in a mean of the misfit
    #: measurement: One mode fitted to two (seeds 1131, 1116) has a misfit of 12 and 8, 3 and 3 with means of 8; seven
    #: other bands have 2.2 at most.
    misfit_bins: int = 32
    #: [points] frequencies at which a further mode is tried
    places: int = 81


TUNING = Tuning()
WIDTHS = TUNING.widths


def misfit(fit: BandFit) -> float:
    """What the model leaves of the spectrum, over the scatter that it predicts: normal where the model is true."""
    model, data = fit.model, fit.data
    inverse = np.linalg.inv(np.linalg.cholesky(spectrum(model, data)))
    white = inverse @ data.cross @ np.conj(np.swapaxes(inverse, 1, 2))
    place = np.floor((np.cumsum(data.bins) - 1e-9) / TUNING.misfit_bins)
    starts = np.flatnonzero(np.diff(place, prepend=-1.0) > 0.0)
    bins = np.add.reduceat(data.bins, starts)
    return misfit_of(np.add.reduceat(white, starts, axis=0), bins, model.vector.size)


def misfit_of(white: ComplexArray, bins: FloatArray, parameters: int) -> float:
    """Pearson's statistic of sums of whitened periodogram matrices, less its mean and over its sd.

    Parameters
    ----------
    white : complex array, shape (g, r, r)
        Sums of ``bins`` matrices ``x x*``, with x standard complex normal where the model is true.
    bins : array, shape (g,)
    parameters : int
        Fitted ones, each of which takes 1 from the mean and 2 from the variance.

    Notes
    -----
    ``n |S - I|^2`` for the mean S of n matrices has the mean r^2 and, from the moments of complex Wishart matrices,
    the variance ``2 r^2 + (6 r + 12 r (r - 1) + 4 r (r - 1) (r - 2)) / n``.
    """
    r = int(white.shape[1])
    mean = white / bins[:, None, None] - np.eye(r)
    value = float(bins @ np.sum(np.abs(mean) ** 2, axis=(1, 2)))
    excess = 6.0 * r + 12.0 * r * (r - 1) + 4.0 * r * (r - 1) * (r - 2)
    free = max(float(bins.size * r * r - parameters), 1.0)
    return (value - free) / math.sqrt(2.0 * free + excess * float(np.sum(1.0 / bins)))


def shares(fit: BandFit) -> FloatArray:
    """Largest share of each mode in the power at a frequency in its own direction, shape (m,)."""
    model, data = fit.model, fit.data
    power = np.abs(responses(model, data)[:, model.gains.size :]) ** 2
    inverse = np.real(np.linalg.inv(spectrum(model, data)))
    own = np.einsum("rm,grs,sm->gm", model.shapes, inverse, model.shapes, optimize=True)
    return np.asarray(np.max(power * own, axis=0, initial=0.0), dtype=np.float64)


def without_modes(data: BandData) -> BandModel:
    """Background only, a first guess."""
    mean = data.cross / data.bins[:, None, None]
    power = np.real(np.trace(mean, axis1=1, axis2=2))
    # The weaker half: what lies off the peaks.
    low = power <= np.median(power)
    floor = np.real(np.sum(data.cross[low], axis=0)) / np.sum(data.bins[low])
    floor += 1e-6 * np.trace(floor) / data.size * np.eye(data.size)
    none, r = np.empty(0), data.size
    none_of = np.zeros((r, 0))
    floor = np.linalg.cholesky(floor)
    t = data.tail_shapes.shape[1]
    mixing = np.zeros((t, t), dtype=complex)
    return BandModel(none, none, np.zeros(t), mixing, none_of, none_of.astype(complex), floor, np.zeros(r))


def choose_order(
    data: BandData,
    limits_hz: tuple[float, float],
    peaks: list[tuple[float, float]],
    log_places: float,
) -> BandFit:
    """Fit of the modes of a band, as many as the evidence asks for.

    Parameters
    ----------
    data : BandData
    limits_hz : (float, float)
        Within which the frequencies lie.
    peaks : list of (float, float)
        Frequencies and half-widths in Hz of the peaks seen in the band, first guesses.
    log_places : float
        Logarithm of the number of bands of this width in the spectrum, each of which may hold a mode by chance.

    Notes
    -----
    The logarithm of the odds of one more mode is the gain of the log likelihood less the Schwarz criterion, half the
    number of its parameters times the logarithm of the number of frequencies, less `log_places`. Coherences with the
    background, which have a proper prior, count by Laplace's approximation: how much narrower they became.
    """
    start = without_modes(data)
    fit = fit_band(start, data, limits_hz)
    total = float(np.sum(data.bins))
    while fit.model.count < MOST_MODES:
        best = None
        # Twice the coherences with the modes so far and the tails, the shape, frequency and damping ratio.
        price = 0.5 * (2 * fit.model.total + data.size + 2) * np.log(total) + log_places
        origins = [(fit.model, fit.data)]
        if not fit.model.count and fit.model.total:
            # Without a mode, the tails were fitted to its peak: of either guess the fit may end beside the best.
            origins = [(start, data), *origins]
        unexplained = _unexplained(fit.model, peaks)
        guesses = [(_from_peak(*one, *peak), one[1]) for one in origins for peak in unexplained]
        further = []
        if fit.model.count or not guesses:
            further += further_modes(fit, limits_hz, [half for _, half in peaks], price)
        if fit.model.count == 1 and misfit(fit) > TUNING.pair_misfit:
            further += pair_instead(fit, limits_hz)
        for guess, seen in (*guesses, *((one, fit.data) for one in further)):
            wanted = fit.log_likelihood + price if best is None else best.log_likelihood
            trial = fit_band(guess, seen, limits_hz, wanted)
            if best is None or trial.log_likelihood > best.log_likelihood:
                best = trial
        if best is None:
            break
        log_odds = best.log_likelihood - fit.log_likelihood - price
        log_odds += best.log_coherences - fit.log_coherences
        if log_odds < logit(DECIDED):
            break
        fit = best
    return fit


def _unexplained(model: BandModel, peaks: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Peaks without a mode nearby."""
    known = np.exp(model.log_hz)
    return [(hz, half) for hz, half in peaks if not np.any(np.abs(known - hz) < 2.0 * half)]


def _from_peak(model: BandModel, data: BandData, hz: float, half_hz: float) -> BandModel:
    """The model with a mode whose shape is the main direction of the motion near a peak."""
    zeta = half_hz / hz
    return model.with_mode(hz, zeta, _shape_at(data, spectrum(model, data), hz, zeta))


def _power(data: BandData, hz: FloatArray | float, zeta: FloatArray | float) -> FloatArray:
    """Squared receptance over that at rest, at the frequencies of a band."""
    ratio = data.frequency_hz / hz
    return np.asarray(1.0 / ((1.0 - ratio**2) ** 2 + (2.0 * zeta * ratio) ** 2))


def _shape_at(data: BandData, matrix: ComplexArray, hz: float, zeta: float) -> FloatArray:
    """Main direction of what `matrix` leaves of the spectrum near a frequency, scaled to its power."""
    weight = _power(data, hz, zeta)
    left = np.real(data.cross - data.bins[:, None, None] * matrix)
    values, vectors = np.linalg.eigh(np.tensordot(weight, left, 1) / float(data.bins @ weight**2))
    # Where nothing is left, a tenth of what is there: a mode of no amplitude has no slope.
    least = 1e-3 * float(np.min(np.real(np.trace(matrix, axis1=1, axis2=2)) / weight))
    return np.asarray(np.sqrt(max(float(values[-1]), least)) * vectors[:, -1])


def further_modes(
    fit: BandFit,
    limits_hz: tuple[float, float],
    half_widths_hz: list[float],
    price: float,
) -> list[BandModel]:
    """The model with one more mode, by the best of the score test over frequencies and damping ratios.

    None where the gain that the test predicts is far below `price`, that of a mode.

    At amplitude 0 the slope of the log likelihood along ``D_k v v^T`` is
    ``v^T [sum D_k Re(E^-1 (C_k - b_k E) E^-1)] v``, and its variance the Fisher information
    ``sum b_k D_k^2 (v^T E^-1 v)^2``.
    """
    model, data = fit.model, fit.data
    matrix = spectrum(model, data)
    inverse = np.linalg.inv(matrix)
    excess = np.real(inverse @ (data.cross - data.bins[:, None, None] * matrix) @ inverse)
    halves = np.unique(np.outer(half_widths_hz, [1.0 / WIDTHS, 1.0, WIDTHS]))
    places = np.linspace(*limits_hz, TUNING.places)[1:-1]
    hz, half = (axis.ravel() for axis in np.meshgrid(places, halves))
    half = np.minimum(half, WIDEST * (limits_hz[1] - limits_hz[0]))
    zeta = half / hz
    response = _power(data, hz[:, None], zeta[:, None])
    values, vectors = np.linalg.eigh(np.tensordot(response, excess, 1))
    slope, shape = values[:, -1], vectors[:, :, -1]
    own = np.einsum("ti,gij,tj->tg", shape, np.real(inverse), shape, optimize=True)
    information = np.maximum(((response * own) ** 2) @ data.bins, 1e-300)
    score = slope / np.sqrt(information)
    found: list[BandModel] = []
    for index in np.argsort(-score).tolist():
        apart = [abs(hz[index] - np.exp(one.log_hz[-1])) > half[index] for one in found]
        if score[index] > 0.0 and 0.5 * score[index] ** 2 > PROMISING * price and all(apart):
            guess = float(hz[index]), float(zeta[index])
            found.append(model.with_mode(*guess, _shape_at(data, matrix, *guess)))
        if len(found) == PLACES:
            break
    return found


def pair_instead(single: BandFit, limits_hz: tuple[float, float]) -> list[BandModel]:
    """Two modes in place of one: the most likely pair about it, their shapes by least squares; none or one.

    A fit of one mode to two has a shape between theirs, from which adding a mode does not lead to the pair.
    """
    data, background = single.data, without_modes(single.data)
    hz = float(np.exp(single.model.log_hz[0]))
    half = hz * float(np.exp(single.model.log_zeta[0]))
    places = hz + half * TUNING.pair_reach * np.array([-1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0])
    tried = [
        (f, width * half / f)
        for f in places.tolist()
        if limits_hz[0] < f < limits_hz[1]
        for width in (TUNING.pair_width, 1.0)
    ]
    response = _power(data, *np.array(tried).T[:, :, None])
    seen = np.real(data.cross / data.bins[:, None, None])
    # The scatter of a mean of b periodograms is its size over sqrt(b).
    weight = np.sqrt(data.bins) / np.real(np.trace(seen, axis1=1, axis2=2))
    best, most = None, -np.inf
    for i, j in combinations(range(len(tried)), 2):
        if tried[i][0] == tried[j][0]:
            continue
        terms = np.column_stack([response[i], response[j], np.ones(weight.size)]) * weight[:, None]
        parts = np.linalg.lstsq(terms, (seen * weight[:, None, None]).reshape(weight.size, -1))[0]
        model = background
        for (f, zeta), part in zip((tried[i], tried[j]), parts, strict=False):
            values, vectors = np.linalg.eigh(part.reshape(data.size, data.size))
            model = model.with_mode(f, zeta, np.sqrt(max(float(values[-1]), 0.0)) * vectors[:, -1])
        value = log_likelihood(model, data)
        if value > most:
            best, most = model, value
    return [] if best is None else [best]

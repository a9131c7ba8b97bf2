"""Likelihood of the modes in one band of a spectrum, and its maximum by Fisher scoring."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from modal_id.ambient.spectrum import transfer
from modal_id.fit import MAX_DAMPING
from modal_id.solve import MAX_ITERATIONS
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Prior of the background, and steps of the maximisation."""

    #: [1] prior sd of the exponents with which the background changes over a band
    #: physics: Far above the resonance of another mode its displacement falls with the fourth power of the frequency.
    exponent_sd: float = 2.0
    #: [1] predicted gain in log likelihood below which the maximum is reached
    #: statistics: A hundredth of the gain that moves a parameter by one sd, 0.5.
    converged: float = 5e-3
    #: [steps] number of steps after which a fit that falls short is given up
    patience: int = 6
    #: [1] gain that a fit may still have over that which its next step predicts
    #: measurement: Fits that gained more than twice the prediction of the seventh step are not seen.
    optimism: float = 3.0
    #: [1] largest change of the logarithm of a frequency over that of the damping ratio in a step
    longest: float = 0.7
    #: [1] prior sd of the coherence of a mode's force with the background
    #: physics: Forces of different modes are partly coherent.
    coherent_sd: float = 0.5
    #: [1] prior sd of the logarithm of the amplitude of a mode beside the band, over that found in its own
    #: physics: The spectrum of the force is that at another frequency; its displacement counts by its square root.
    tail_sd: float = 0.5
    #: [1] largest exponent
    #: physics: That of a displacement far above a resonance.
    most_exponent: float = 4.0
    #: [1] change of a logarithm for difference quotients
    #: convention: Rounding and curvature are both below 1e-7 of the slope.
    difference: float = 1e-6
    #: [1] largest half-width of a mode over the width of the band
    #: physics: The spectrum of a wider one is not told from the background.
    widest: float = 0.125
    #: [1] 2 pi zeta f T below which a peak is a line
    #: physics: The amplitude then has one independent value in the whole record.
    least_turns: float = 0.2
    #: [modes] most modes in a band
    most_modes: int = 4


TUNING = Tuning()
MOST_MODES, WIDEST = TUNING.most_modes, TUNING.widest


@dataclass(frozen=True)
class BandData:
    """Periodogram matrices of a band in r directions, neighbouring frequencies in sums.

    Attributes
    ----------
    frequency_hz : array, shape (g,)
        Mean of each sum.
    bins : array, shape (g,)
        Number of frequencies in each sum.
    cross : complex array, shape (g, r, r)
        Sums of the products ``F F*``, whose mean is the one-sided spectral density.
    samples, step_s : int, float
        Of the record.
    directions : array, shape (k, r)
        Values of the channels for a unit of each direction.
    tail_shapes : array, shape (r, t)
        As `BandModel.shapes`, of modes beside the band.
    tail_responses : complex array, shape (g, t)
        Their receptances in the band.
    log_det : float
        Logarithm of the determinant of the change of directions since the first ones.
    """

    frequency_hz: FloatArray
    bins: FloatArray
    cross: ComplexArray
    samples: int
    step_s: float
    directions: FloatArray
    tail_shapes: FloatArray
    tail_responses: ComplexArray
    log_det: float = 0.0

    @property
    def size(self) -> int:
        """Number of directions."""
        return int(self.cross.shape[1])

    @cached_property
    def log_ratio(self) -> FloatArray:
        """Logarithm of the frequency over its mean in the band, shape (g,)."""
        logs = np.log(self.frequency_hz)
        return np.asarray(logs - np.average(logs, weights=self.bins))

    def turned(self, matrix: FloatArray) -> BandData:
        """The same data in other directions: ``matrix @ F`` in place of F."""
        return replace(
            self,
            cross=matrix @ self.cross @ matrix.T,
            directions=self.directions @ np.linalg.inv(matrix),
            tail_shapes=matrix @ self.tail_shapes,
            log_det=self.log_det + float(np.linalg.slogdet(matrix)[1]),
        )


@dataclass(frozen=True)
class BandModel:
    """n modes and a background: ``E = G G*``, ``G = [P diag(h) L + B K, B]``, ``B = Q diag((f / f0)^(a / 2))``.

    The first t modes are tails: modes beside the band, whose poles and shapes are known. The other m are in the band.
    The background is noise, and the responses of modes further away, whose shapes are real and whose phase does not
    change in the band: ``B B^T`` is a real matrix of any rank. Their forces may be coherent with those in the band, by
    K: left out, the interference is taken for further modes of large damping.

    Attributes
    ----------
    log_hz, log_zeta : array, shape (m,)
    gains : array, shape (t,)
        Logarithms of the amplitudes of the tails over those found in their own bands.
    mixing : complex array, shape (n, n)
        Below the diagonal, the free numbers of L, whose rows have length 1: ``L L*`` is the coherence of the forces.
    shapes : array, shape (r, m)
        Columns of P: square root of the spectral density of a mode's force times its shape, without a norm.
    coherent : complex array, shape (r, m)
        K, without the zeros of the tails.
    floor : array, shape (r, r)
        Q, lower triangular.
    exponents : array, shape (r,)
        a.
    """

    log_hz: FloatArray
    log_zeta: FloatArray
    gains: FloatArray
    mixing: ComplexArray
    shapes: FloatArray
    coherent: ComplexArray
    floor: FloatArray
    exponents: FloatArray

    @property
    def count(self) -> int:
        """Number of modes."""
        return self.log_hz.size

    @property
    def total(self) -> int:
        """Number of modes with the tails."""
        return self.gains.size + self.count

    @property
    def vector(self) -> FloatArray:
        """All parameters: of the modes, then of the background."""
        free = self.mixing[_below(self.total, -1)]
        of_floor = self.floor[_below(self.exponents.size, 0)]
        k = self.coherent
        parts = [
            self.log_hz,
            self.log_zeta,
            self.gains,
            free.real,
            free.imag,
            self.shapes.ravel(),
            k.real.ravel(),
            k.imag.ravel(),
        ]
        return np.concatenate([*parts, of_floor, self.exponents])

    @property
    def ends(self) -> tuple[int, ...]:
        """Where the parts of `vector` end: f, zeta, gains, both parts of L, P, both parts of K, Q."""
        m, n, r = self.count, self.total, self.exponents.size
        pairs = n * (n - 1) // 2
        sizes = [m, m, self.gains.size, pairs, pairs, r * m, r * m, r * m, r * (r + 1) // 2]
        return tuple(np.cumsum(sizes).tolist())

    def at(self, vector: FloatArray) -> BandModel:
        """The model with these parameters."""
        m, n, r = self.count, self.total, self.exponents.size
        hz, zeta, gains, real, imag, shapes, k_real, k_imag, of_floor, exponents = np.split(vector, self.ends)
        mixing, floor = np.zeros((n, n), dtype=complex), np.zeros((r, r))
        mixing[_below(n, -1)] = real + 1j * imag
        floor[_below(r, 0)] = of_floor
        coherent = (k_real + 1j * k_imag).reshape(r, m)
        return BandModel(hz, zeta, gains, mixing, shapes.reshape(r, m), coherent, floor, exponents)

    def with_mode(self, hz: float, zeta: float, shape: FloatArray) -> BandModel:
        """The model with one more mode, whose force is not coherent with the others."""
        n = self.total
        mixing = np.zeros((n + 1, n + 1), dtype=complex)
        mixing[:n, :n] = self.mixing
        return replace(
            self,
            log_hz=np.append(self.log_hz, np.log(hz)),
            log_zeta=np.append(self.log_zeta, np.log(zeta)),
            mixing=mixing,
            shapes=np.column_stack([self.shapes, shape]),
            coherent=np.column_stack([self.coherent, np.zeros(shape.size, dtype=complex)]),
        )

    @property
    def prior(self) -> FloatArray:
        """Inverse variances of the normal priors of all parameters, 0 where there is none."""
        _, zeta, gains, _, _, shapes, _, k_imag, of_floor = self.ends
        inverse = np.zeros(of_floor + self.exponents.size)
        inverse[zeta:gains] = TUNING.tail_sd**-2
        inverse[shapes:k_imag] = TUNING.coherent_sd**-2
        inverse[of_floor:] = TUNING.exponent_sd**-2
        return inverse

    @property
    def lower(self) -> ComplexArray:
        """L, shape (n, n)."""
        raw = np.tril(self.mixing, -1) + np.eye(self.total)
        return np.asarray(raw / np.linalg.norm(raw, axis=1, keepdims=True))


@cache
def _below(size: int, diagonal: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of a lower triangle: asked for some ten thousand times a record."""
    rows, columns = np.tril_indices(size, diagonal)
    return rows, columns


def responses(model: BandModel, data: BandData) -> ComplexArray:
    """Receptance of each mode, tails first, shape (g, n)."""
    columns = [
        transfer(data.frequency_hz, float(np.exp(hz)), float(np.exp(zeta)), data.samples, data.step_s)
        for hz, zeta in zip(model.log_hz, model.log_zeta, strict=True)
    ]
    return np.column_stack([data.tail_responses * np.exp(model.gains), *columns])


def _shapes(model: BandModel, data: BandData) -> FloatArray:
    """P, shape (r, n)."""
    return np.column_stack([data.tail_shapes, model.shapes])


def spectrum(model: BandModel, data: BandData) -> ComplexArray:
    """E, shape (g, r, r)."""
    return _spectrum(model, data, responses(model, data))


def _spectrum(model: BandModel, data: BandData, response: ComplexArray) -> ComplexArray:
    factor, background = _factors(model, data, response)
    return np.asarray(
        factor @ np.conj(np.swapaxes(factor, 1, 2)) + background @ np.swapaxes(background, 1, 2)
    )


def _factors(model: BandModel, data: BandData, response: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    """The columns of G of the modes, shape (g, r, n), and of the background, shape (g, r, r)."""
    background = model.floor * _powers(model, data)[:, None, :]
    modes = (_shapes(model, data) * response[:, None, :]) @ model.lower
    return modes + background @ _coherent(model), background


def _coherent(model: BandModel) -> ComplexArray:
    """K, shape (r, n)."""
    return np.column_stack([np.zeros((model.exponents.size, model.gains.size)), model.coherent])


def _powers(model: BandModel, data: BandData) -> FloatArray:
    """Square root of the powers of the frequency, shape (g, r)."""
    return np.asarray(np.exp(0.5 * np.outer(data.log_ratio, model.exponents)))


def log_likelihood(model: BandModel, data: BandData) -> float:
    """Of the band in its first directions, with the priors, without constants."""
    matrix = spectrum(model, data)
    sign, log_det = np.linalg.slogdet(matrix)
    if not np.all(sign.real > 0.0):
        return -np.inf
    fit = np.real(np.trace(np.linalg.solve(matrix, data.cross), axis1=1, axis2=2))
    log_det = log_det - 2.0 * data.log_det
    return float(-np.sum(data.bins * log_det + fit)) - 0.5 * float(model.prior @ model.vector**2)


@dataclass(frozen=True)
class BandFit:
    """Maximum of the likelihood and the Fisher information of all parameters, (p, p), in the directions of `data`."""

    model: BandModel
    data: BandData
    log_likelihood: float
    information: FloatArray

    @cached_property
    def covariance(self) -> FloatArray:
        """Of all parameters, shape (p, p); with a tiny ridge, as a mode of no amplitude has no frequency."""
        scale = np.sqrt(np.maximum(np.diag(self.information), 1e-12))
        scaled = self.information / np.outer(scale, scale)
        inverse = np.linalg.inv(scaled + 1e-9 * np.eye(scale.size))
        return np.asarray(inverse / np.outer(scale, scale))

    @cached_property
    def log_coherences(self) -> float:
        """Logarithm of the volume of the coherences with the background, over that of their prior."""
        own = slice(self.model.ends[5], self.model.ends[7])
        return 0.5 * float(np.linalg.slogdet(self.covariance[own, own] / TUNING.coherent_sd**2)[1])


def fit_band(
    model: BandModel, data: BandData, limits_hz: tuple[float, float], wanted: float = -np.inf
) -> BandFit:
    """Maximise the likelihood from a first guess, frequencies kept within the limits.

    Ends early where the logarithm of the likelihood will not reach `wanted`.

    In directions in which the background is white and the modes come first: in others, where a mode is far above the
    noise, its shape and the background can only turn together. Fisher scoring with Levenberg's damping: the expected
    information is positive wherever it is taken.
    """
    model, data = _whitened(model, data)
    value, damping = log_likelihood(model, data), 1e-3
    gradient, information = _score(model, data)
    for count in range(MAX_ITERATIONS):
        scale = np.maximum(np.diag(information), 1e-12)
        step = np.asarray(np.linalg.solve(information + damping * np.diag(scale), gradient), dtype=np.float64)
        if count > TUNING.patience and value + TUNING.optimism * float(gradient @ step) < wanted:
            break
        trial = _limited(model, model.vector + _shortened(step, model.count), data, limits_hz)
        reached = log_likelihood(trial, data)
        if not reached > value:
            if damping > 1e4:
                break
            damping *= 10.0
            continue
        gain, value, model = reached - value, reached, trial
        gradient, information = _score(model, data)
        if gain < TUNING.converged and damping < 1.0:
            break
        damping = max(0.1 * damping, 1e-9)
    return BandFit(model, data, value, information)


def _whitened(model: BandModel, data: BandData) -> tuple[BandModel, BandData]:
    """The model, its exponents averaged, and the data in directions of unit background that begin with the shapes."""
    whitening = np.linalg.inv(model.floor)
    rotation = (
        np.linalg.qr(whitening @ model.shapes, mode="complete")[0] if model.count else np.eye(data.size)
    )
    turn = rotation.T @ whitening
    turned = replace(
        model,
        shapes=turn @ model.shapes,
        coherent=rotation.T @ model.coherent,
        floor=np.eye(data.size),
        exponents=np.full(data.size, float(np.mean(model.exponents))),
    )
    return turned, data.turned(turn)


def _shortened(step: FloatArray, count: int) -> FloatArray:
    longest = float(np.max(np.abs(step[: 2 * count]), initial=0.0))
    return step * min(1.0, TUNING.longest / max(longest, 1e-300))


def _limited(
    model: BandModel, vector: FloatArray, data: BandData, limits_hz: tuple[float, float]
) -> BandModel:
    m = model.count
    vector[:m] = np.clip(vector[:m], *np.log(limits_hz))
    least = TUNING.least_turns / (2.0 * np.pi * np.exp(vector[:m]) * data.samples * data.step_s)
    # A response wider than an eighth of the band is not told from the background.
    most = np.minimum(MAX_DAMPING, WIDEST * (limits_hz[1] - limits_hz[0]) / np.exp(vector[:m]))
    vector[m : 2 * m] = np.clip(vector[m : 2 * m], np.log(least), np.log(most))
    r = data.size
    vector[-r:] = np.clip(vector[-r:], -TUNING.most_exponent, TUNING.most_exponent)
    return model.at(vector)


def _score(model: BandModel, data: BandData) -> tuple[FloatArray, FloatArray]:
    """Gradient of the log likelihood, shape (p,), and the Fisher information, shape (p, p)."""
    g, r = data.cross.shape[:2]
    response = responses(model, data)
    inverse: ComplexArray = np.linalg.inv(np.linalg.cholesky(_spectrum(model, data, response))).astype(
        complex
    )
    misfit = inverse @ data.cross @ np.conj(np.swapaxes(inverse, 1, 2)) - data.bins[:, None, None] * np.eye(r)
    changes = _mode_changes(model, data, response, inverse)
    factor, background = (inverse @ one for one in _factors(model, data, response))
    of_modes = np.stack(changes) @ np.conj(np.swapaxes(factor, 1, 2)) if changes else np.zeros((0, g, r, r))
    half = np.concatenate([of_modes, _background_slopes(model, data, inverse, factor, background)])
    whitened = half + np.conj(np.swapaxes(half, 2, 3))
    # Real and imaginary parts side by side: the products of Hermitian matrices are real.
    weighted = (whitened * data.bins[:, None, None]).reshape(-1, g * r * r).view(np.float64)
    parts = whitened.reshape(-1, g * r * r).view(np.float64)
    gradient = parts @ misfit.ravel().view(np.float64)
    information = weighted @ parts.T
    return gradient - model.prior * model.vector, information + np.diag(model.prior)


def _mode_changes(
    model: BandModel, data: BandData, response: ComplexArray, inverse: ComplexArray
) -> list[ComplexArray]:
    """Derivatives of G's columns of the modes by the parameters of the modes, whitened, shape (g, r, n) each."""
    m, t, (g, r) = model.count, model.gains.size, data.cross.shape[:2]
    lower, white_shapes = model.lower, inverse @ _shapes(model, data)
    inner = response[:, :, None] * lower
    changes = [
        white_shapes[:, :, t + mode, None] * (slope[:, None, None] * lower[t + mode])
        for slopes in zip(*(_response_slopes(model, data, mode) for mode in range(m)), strict=True)
        for mode, slope in enumerate(slopes)
    ]
    changes += [white_shapes[:, :, tail, None] * inner[:, None, tail, :] for tail in range(t)]
    rows, columns = _below(model.total, -1)
    for unit in (1.0, 1j):
        for i, j in zip(rows, columns, strict=True):
            moved = model.mixing.copy()
            moved[i, j] += TUNING.difference * unit
            slope = (replace(model, mixing=moved).lower - lower) / TUNING.difference
            changes.append((white_shapes * response[:, None, :]) @ slope)
    changes += [
        inverse[:, :, row, None] * inner[:, None, t + mode, :] for row in range(r) for mode in range(m)
    ]
    white = inverse @ (model.floor * _powers(model, data)[:, None, :])
    for unit in (1.0, 1j):
        for row in range(r):
            for mode in range(m):
                change = np.zeros((g, r, t + m), dtype=complex)
                change[:, :, t + mode] = unit * white[:, :, row]
                changes.append(change)
    return changes


def _response_slopes(model: BandModel, data: BandData, mode: int) -> tuple[ComplexArray, ComplexArray]:
    """Derivatives of a receptance with respect to the logarithms of frequency and damping ratio, shape (g,) each."""
    values = np.array([model.log_hz[mode], model.log_zeta[mode]])
    slopes = []
    for axis in range(2):
        sides = []
        for sign in (1.0, -1.0):
            moved = values.copy()
            moved[axis] += sign * TUNING.difference
            hz, zeta = (float(x) for x in np.exp(moved))
            sides.append(transfer(data.frequency_hz, hz, zeta, data.samples, data.step_s))
        slopes.append((sides[0] - sides[1]) / (2.0 * TUNING.difference))
    return slopes[0], slopes[1]


def _background_slopes(
    model: BandModel, data: BandData, inverse: ComplexArray, factor: ComplexArray, background: ComplexArray
) -> ComplexArray:
    """Half of the whitened derivatives of E by Q and a; the rest is its adjoint. Shape (p, g, r, r)."""
    powers = _powers(model, data)
    # Column j of B stands in G as B [K, I].
    whole = np.moveaxis(factor @ np.conj(_coherent(model).T) + background, 2, 0)
    rows, columns = _below(data.size, 0)
    left = np.moveaxis(inverse[:, :, rows] * powers[:, None, columns], 2, 0)
    of_floor = left[..., :, None] * np.conj(whole[columns])[..., None, :]
    steep = np.moveaxis(background, 2, 0)[..., :, None] * np.conj(whole)[..., None, :]
    return np.concatenate([of_floor, 0.5 * data.log_ratio[:, None, None] * steep])

"""Sampling of (natural frequency, damping ratio) of a mode by emcee, linear parameters marginalised in closed form.

The likelihood comes from moments about the fitted pole, which replace the samples exactly.
The proposal is independent of the walkers: constant in each cell of a polar grid about the best fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import emcee
import numpy as np
from emcee.moves import Move
from emcee.state import State
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from modal_id.posterior.noise import NoiseLevel
from modal_id.posterior.reduction import ReducedLikelihood, Reduction, reduction
from modal_id.sentences import Reason
from modal_id.settings import SamplerSettings
from modal_id.solve import ModeColumns, PoleFit, Problem, pole, solve_linear, thinning
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Accuracy of the likelihood, cells of the proposal density, autocorrelation."""

    #: [1] relative size of the first neglected term of the series
    #: physics: Far below a change of the log likelihood that matters.
    remainder: float = 1e-9
    #: [1] largest number of terms of the series
    max_terms: int = 60
    #: [1] logarithm of the largest energy of a wave, or density, over one that is negligible
    #: physics: exp(-13.8) = 1e-6.
    negligible: float = 13.8
    #: [1] side of a tile over its least decay rate
    #: physics: Its diagonal times the time in which the slowest wave becomes negligible is then 2.5.
    side: float = 0.25
    #: [1] number of terms within a tile
    #: physics: The first neglected term is then below `remainder`, too.
    tile_terms: int = 20
    #: [1] largest number of samples in all tiles together
    #: convention: Limits the memory.
    max_tile_samples: int = 4_000_000
    #: [sd] width of a cell near the mode
    width: float = 0.1
    #: [sd] distance up to which cells have that width
    fine: float = 4.0
    #: [1] ratio of successive widths further out
    growth: float = 1.1
    #: [1] number of sectors in a ring
    sectors: int = 32
    #: [1] number of rings added at a time
    rings: int = 8
    #: [1] number of steps whose proposals are drawn together
    #: convention: Limits the computing time.
    steps: int = 20
    #: [autocorrelation times] steps over which an autocorrelation is summed
    #: convention: As emcee does (Sokal).
    window: float = 5.0


TUNING = Tuning()
NEGLIGIBLE = TUNING.negligible


class Likelihood(Protocol):
    """Weighted residual sum of squares of one mode's pole, all other parameters eliminated."""

    @property
    def centre_per_s(self) -> complex:
        """The fitted pole."""

    def chi_square(self, change_per_s: ComplexArray) -> FloatArray:
        """Residual sum of squares over the noise variance for poles ``centre + change``; shape (w,) in and out."""


@dataclass(frozen=True)
class TiledLikelihood:
    """Likelihood of a pole that is too uncertain for one series: a series for each square tile of the complex plane.

    A wave that decays faster is shorter, and its tile larger: from one octave of decay rates to the next, the side
    doubles. Below `least_per_s`, all waves last as long as the record. Tiles are computed when a pole first lies in
    them; their values do not depend on the order.
    """

    reduction: Reduction
    centre_per_s: complex
    least_per_s: float
    tiles: dict[tuple[float, complex], ReducedLikelihood] = field(default_factory=dict)

    def chi_square(self, change_per_s: ComplexArray) -> FloatArray:
        """As in `Likelihood`."""
        poles = self.centre_per_s + change_per_s
        side = _side(poles.real, self.least_per_s)
        place = np.floor(poles.real / side) + 1j * np.floor(poles.imag / side)
        result = np.empty(poles.size)
        for width, corner in {*zip(side.tolist(), place.tolist(), strict=True)}:
            here = (side == width) & (place == corner)
            middle = width * (corner + 0.5 + 0.5j)
            tile = (width, corner)
            if tile not in self.tiles:
                self.tiles[tile] = self.reduction.about(middle, TUNING.tile_terms)
            result[here] = self.tiles[tile].chi_square(poles[here] - middle)
        return result


def reduce_mode(
    problem: Problem, fit: PoleFit, mode: int, close: NDArray[np.intp], reach_per_s: float
) -> Likelihood | None:
    """Likelihood of the pole with index `mode`.

    `close` are the indices of the poles whose uncertainty contributes to that of this one, `reach_per_s` is the largest
    change of the pole for which the likelihood must hold. Where one series would need more than 60 terms, because the
    pole is hardly determined, the plane is divided into tiles, and neighbouring samples are averaged to 24 per cycle,
    which costs 0.3 % of the information. None when even that takes too long.
    """
    centre = complex(fit.poles[mode])
    time = problem.data.time_s
    # The series must hold for the slowest wave, too, which lasts longest.
    terms = _terms_needed(time, min(centre.real + reach_per_s, 0.0), reach_per_s)
    if terms is not None:
        return reduction(problem, fit, mode, close).about(centre, terms)
    factor = thinning(time, 2.0 * fit.poles)
    if factor > 1:
        problem = problem.thinned(factor)
        linear = solve_linear(problem, ModeColumns(problem.data.time_s, fit.poles))
        # The weights of averages count their samples: the variance of one is that of the whole fit.
        fit = replace(fit, linear=replace(linear, noise_variance=fit.linear.noise_variance))
    least = 0.5 * NEGLIGIBLE / problem.data.span_s
    tiles = (2.0 * reach_per_s / float(_side(np.array(centre.real), least)) + 1.0) ** 2
    if tiles * problem.data.time_s.size > TUNING.max_tile_samples:
        return None
    return TiledLikelihood(reduction(problem, fit, mode, close), centre, least)


def _side(real_per_s: FloatArray, least_per_s: float) -> FloatArray:
    """Side of the tile that holds a pole with this real part."""
    octave = np.floor(np.log2(np.maximum(-real_per_s / least_per_s, 1.0)))
    return np.asarray(TUNING.side * least_per_s * 2.0**octave)


def _terms_needed(time_s: FloatArray, growth_per_s: float, reach_per_s: float) -> int | None:
    # The radius is set by the time at which the wave has lost its energy; doubled for exp(2 lambda t).
    radius, size = 2.0 * reach_per_s * _last_s(time_s, growth_per_s), 1.0
    for power in range(1, TUNING.max_terms):
        size *= radius / power
        if size < TUNING.remainder and power >= 6:
            return power + 1
    return None


def _last_s(time_s: FloatArray, growth_per_s: float) -> float:
    """Time after which a millionth of the energy of a wave is left."""
    energy = np.gradient(time_s)
    energy *= np.exp(2.0 * growth_per_s * time_s)
    np.cumsum(energy, out=energy)
    return float(
        time_s[min(int(np.searchsorted(energy, (1.0 - np.exp(-NEGLIGIBLE)) * energy[-1])), time_s.size - 1)]
    )


# Positions further than this from the best fit are outside the likelihood's series of moments, which may have any
# value there; in Laplace's standard deviations.
REACH_SD = 10.0


@dataclass(frozen=True)
class PoleDensity:
    """Log posterior density of (omega_n, zeta), in units of their Laplace standard deviations from the best fit.

    Notes
    -----
    The prior is flat in (omega_n, zeta) for zeta > 0, and flat in the amplitudes measured by their energy in the record
    (the conditional reference prior). With a prior flat in the amplitudes themselves each channel would bias zeta
    upwards by the factor |G|^(-1/2) of its Gram matrix, and the bias would grow with the number of markers. The noise
    level near the mode is estimated with a finite number of degrees of freedom; marginalised over it (Jeffreys' prior),
    the density is Student's t in the increase of chi-square.
    """

    likelihood: Likelihood
    centre: tuple[float, float]
    scale: tuple[float, float]
    noise: NoiseLevel
    chi_square_min: float

    def __call__(self, position: FloatArray) -> FloatArray:
        """Log density, shape (w,), for positions of shape (w, 2); -inf where zeta <= 0 or out of reach."""
        omega, zeta = (self.centre[i] + self.scale[i] * position[:, i] for i in range(2))
        inside = np.hypot(*position.T) < REACH_SD
        inside &= (zeta > 0.0) & (zeta < 1.0) & (omega > 0.0)
        change = np.where(
            inside, pole(omega, np.where(inside, zeta, 0.0)) - self.likelihood.centre_per_s, 0.0
        )
        increase = self.likelihood.chi_square(change) - self.chi_square_min
        argument = increase / (self.noise.dof * self.noise.factor**2)
        value = -0.5 * (self.noise.dof + 2.0) * np.log1p(np.maximum(argument, -0.5))
        return np.where(inside & np.isfinite(value), value, -np.inf)


@dataclass(frozen=True)
class PolarProposal:
    """Density that is constant in each cell, with the mean of the density to be sampled at the cell's corners.

    Attributes
    ----------
    factor : array, shape (2, 2)
        Lower triangular; positions are ``factor @ (radius cos(angle), radius sin(angle))``.
    squares : array, shape (rings + 1,)
        Squared radii of the edges, from 0.
    log_density : array, shape (rings, sectors)
        Of each cell, up to a constant.
    cumulative : array, shape (rings * sectors,)
        Probability of all cells up to each one; the last is 1.
    """

    factor: FloatArray
    squares: FloatArray
    log_density: FloatArray
    cumulative: FloatArray

    def draw(self, numbers: FloatArray) -> FloatArray:
        """Positions, shape (w, 2), from uniform random numbers below 1, shape (w, 3)."""
        cell = np.searchsorted(self.cumulative[:-1], numbers[:, 0], side="right")
        ring, sector = np.divmod(cell, TUNING.sectors)
        radius = np.sqrt(self.squares[ring] + numbers[:, 1] * np.diff(self.squares)[ring])
        return _positions(radius, 2.0 * np.pi / TUNING.sectors * (sector + numbers[:, 2]), self.factor)

    def __call__(self, position: FloatArray) -> FloatArray:
        """Log density up to a constant, shape (w,), at positions, shape (w, 2), from `draw`."""
        x = position[:, 0] / self.factor[0, 0]
        y = (position[:, 1] - self.factor[1, 0] * x) / self.factor[1, 1]
        ring = np.searchsorted(self.squares, x**2 + y**2, side="right") - 1
        sector = (np.arctan2(y, x) * (TUNING.sectors / (2.0 * np.pi))) % TUNING.sectors
        ring, sector = np.minimum(ring, self.log_density.shape[0] - 1), np.minimum(sector, TUNING.sectors - 1)
        return np.asarray(self.log_density[ring, sector.astype(np.intp)])


def polar_proposal(
    log_density: Callable[[FloatArray], FloatArray], correlation: float, reach: float
) -> PolarProposal | None:
    """Proposal for a density of two parameters in units of about a standard deviation.

    Parameters
    ----------
    log_density : callable
        Log density, shape (w,), of positions, shape (w, 2); -inf further than `reach` from 0.
    correlation : float
        Of the parameters near the largest density: it shapes the cells.

    Returns
    -------
    PolarProposal or None
        None where the density is 0 or undefined at all corners.
    """
    factor = np.linalg.cholesky(np.array([[1.0, correlation], [correlation, 1.0]]))
    fine = np.arange(0.0, TUNING.fine, TUNING.width)
    # `factor` shortens no vector by more than this.
    furthest = reach / np.sqrt(1.0 - abs(correlation))
    edges = np.append(
        fine,
        np.geomspace(TUNING.fine, furthest, 1 + int(np.log(furthest / TUNING.fine) / np.log(TUNING.growth))),
    )
    angle = 2.0 * np.pi / TUNING.sectors * np.arange(TUNING.sectors)
    values = np.empty((0, TUNING.sectors))
    while values.shape[0] < edges.size:
        more = edges[values.shape[0] : values.shape[0] + TUNING.rings]
        corners = _positions(np.repeat(more, TUNING.sectors), np.tile(angle, more.size), factor)
        values = np.concatenate([values, log_density(corners).reshape(more.size, TUNING.sectors)])
        if np.max(values[-more.size :]) < np.max(values) - NEGLIGIBLE:
            break
    largest = float(np.max(values))
    if not np.isfinite(largest):
        return None
    density = np.exp(values - largest)
    # Corners of a cell: two edges, two angles.
    density = density[1:] + density[:-1]
    # A cell whose corners all lie outside may contain a sliver.
    density = np.maximum(0.25 * (density + np.roll(density, -1, axis=1)), np.exp(-NEGLIGIBLE))
    squares = edges[: values.shape[0]] ** 2
    mass = np.cumsum((density * np.diff(squares)[:, None]).ravel())
    return PolarProposal(factor, squares, np.log(density), mass / mass[-1])


class IndependenceMove(Move):  # type: ignore[misc]  # emcee has no types
    """Metropolis-Hastings with proposals that do not depend on the walkers: an autocorrelation time of about one step.

    The stretch move has one of about 30 steps. Two parameters can be tabulated; the proposals are drawn from the table.

    The walkers are those of several independent ensembles, one after the other, each with the random stream of the same
    index: they share the calls of the likelihood and nothing else. For samplers with ``vectorize=True``.
    """

    def __init__(self, proposal: PolarProposal, streams: Sequence[np.random.Generator]) -> None:
        self._proposal, self._streams = proposal, tuple(streams)
        self._waiting: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]] = []

    def propose(self, model: Any, state: State) -> tuple[State, BoolArray]:
        """Move each walker once; returns the new state and a mask of the walkers that moved."""
        if not self._waiting:
            self._waiting = self._steps(model, state.coords.shape[0] // len(self._streams))
        proposed, value, log_q, log_chance = self._waiting.pop()
        gain = value - log_q - (state.log_prob - self._proposal(state.coords))
        accepted = gain > log_chance
        state.coords[accepted], state.log_prob[accepted] = proposed[accepted], value[accepted]
        return state, np.asarray(accepted)

    def _steps(self, model: Any, walkers: int) -> list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
        """Positions, log densities, log densities of the proposal, logarithms of random numbers, for each step.

        They do not depend on the walkers: many steps in one call take less time.
        """
        numbers = np.concatenate(
            [stream.random((TUNING.steps, walkers, 4)) for stream in self._streams], axis=1
        )
        proposed = self._proposal.draw(numbers[..., :3].reshape(-1, 3))
        value, log_q = model.log_prob_fn(proposed), self._proposal(proposed)
        count = numbers.shape[1]
        parts = (
            proposed.reshape(TUNING.steps, count, 2),
            value.reshape(TUNING.steps, count),
            log_q.reshape(TUNING.steps, count),
        )
        return list(zip(*parts, np.log1p(-numbers[..., 3]), strict=True))


def _positions(radius: FloatArray, angle: FloatArray, factor: FloatArray) -> FloatArray:
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1) @ factor.T


class SamplingError(Exception):
    """Sampling failed; the message gives the reason."""


@dataclass(frozen=True)
class Draws:
    """Draws of all ensembles with their diagnostics, as in `Posterior`.

    ``long_enough`` states whether every ensemble met the autocorrelation criterion within its budget of steps.
    """

    omega_n_rad_s: FloatArray
    zeta: FloatArray
    log_density: FloatArray
    r_hat: tuple[float, float]
    ess: tuple[float, float]
    autocorrelation_steps: float
    acceptance: float
    long_enough: bool


def sample(
    density: PoleDensity,
    correlation: float,
    settings: SamplerSettings,
    streams: tuple[np.random.SeedSequence, ...],
) -> Draws:
    """Draw from the density with independent ensembles, each with its own random stream.

    `correlation` of omega_n and zeta by Laplace's approximation shapes the proposals.

    Raises
    ------
    SamplingError

    Notes
    -----
    emcee: Foreman-Mackey et al. (2013), doi:10.1086/670067. The stream is passed in through ``State``, because samplers
    in one process would otherwise share NumPy's global stream.
    """
    try:
        stacked, log_density, acceptance, tau, enough = _run(density, correlation, settings, streams)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise SamplingError(Reason.NO_STEPS(error=error)) from error
    r_hat = (_split_r_hat(stacked[..., 0]), _split_r_hat(stacked[..., 1]))
    if max(r_hat) > settings.max_r_hat:
        raise SamplingError(Reason.ENSEMBLES_DISAGREE(r_hat=max(r_hat), most=settings.max_r_hat))
    ess = 0.5 * stacked.size / np.max(tau, axis=0)
    draws = stacked.reshape(stacked.shape[0], -1, 2)
    return Draws(
        density.centre[0] + density.scale[0] * draws[..., 0],
        density.centre[1] + density.scale[1] * draws[..., 1],
        log_density.reshape(draws.shape[:2]),
        r_hat,
        (float(ess[0]), float(ess[1])),
        float(np.max(tau)),
        acceptance,
        enough,
    )


def _run(
    density: PoleDensity,
    correlation: float,
    settings: SamplerSettings,
    streams: tuple[np.random.SeedSequence, ...],
) -> tuple[FloatArray, FloatArray, float, FloatArray, bool]:
    """Chains (ensembles, steps, walkers, 2), their log density, acceptance, autocorrelation times (ensembles, 2).

    And whether the chains are long enough.
    """
    count, walkers = len(streams), settings.walkers
    proposal = polar_proposal(density, correlation, REACH_SD)
    if proposal is None:
        raise SamplingError(Reason.NOT_FINITE())
    generators = [np.random.default_rng(stream) for stream in streams]
    start = [_first_walkers(density, proposal, walkers, generator) for generator in generators]
    move = IndependenceMove(proposal, generators)
    sampler = emcee.EnsembleSampler(count * walkers, 2, density, moves=move, vectorize=True)
    # emcee uses this stream only to choose a move, and there is one.
    state = State(np.concatenate(start), random_state=np.random.RandomState(0).get_state())
    state = sampler.run_mcmc(state, settings.burn_in_steps, skip_initial_state_check=True)
    sampler.reset()
    steps, long_enough = 0, False
    while steps < settings.max_steps and not long_enough:
        more = min(settings.check_steps, settings.max_steps - steps)
        state = sampler.run_mcmc(state, more, skip_initial_state_check=True)
        steps += more
        chains = np.moveaxis(sampler.get_chain().reshape(steps, count, walkers, 2), 1, 0)
        tau = autocorrelation_times(chains)
        long_enough = bool(np.all(np.isfinite(tau)) and steps >= settings.autocorrelation_times * np.max(tau))
    if not np.all(np.isfinite(tau)):
        raise SamplingError(Reason.NONE_ACCEPTED())
    values = np.moveaxis(sampler.get_log_prob().reshape(steps, count, walkers), 1, 0)
    acceptance = float(np.mean(sampler.acceptance_fraction))
    return np.ascontiguousarray(chains), values, acceptance, tau, long_enough


def _first_walkers(
    density: PoleDensity, proposal: PolarProposal, walkers: int, generator: np.random.Generator
) -> FloatArray:
    good = np.empty((0, 2))
    for _ in range(50):
        trial = proposal.draw(generator.random((walkers, 3)))
        good = np.concatenate([good, trial[np.isfinite(density(trial))]])
        if good.shape[0] >= walkers:
            return good[:walkers]
    raise SamplingError(Reason.NOT_FINITE())


def autocorrelation_times(chains: FloatArray) -> FloatArray:
    """Integrated autocorrelation time in steps, at least 1, of each ensemble and parameter; shape (ensembles, p).

    `chains` has shape (ensembles, steps, walkers, p). NaN where a walker never moved. That of
    `emcee.autocorr.integrated_time`, for all walkers at once: the mean autocorrelation of the walkers, summed over a
    window of five times.
    """
    steps = chains.shape[1]
    length = next_fast_len(2 * steps, real=True)
    spectrum = rfft(chains - np.mean(chains, axis=1, keepdims=True), length, axis=1)
    products = irfft(spectrum.real**2 + spectrum.imag**2, length, axis=1)[:, :steps]
    # Walkers that never moved give 0 / 0.
    with np.errstate(invalid="ignore"):
        mean = np.mean(products / products[:, :1], axis=2)
        times = 2.0 * np.cumsum(mean, axis=1) - 1.0
        outside = np.arange(steps)[:, None] >= TUNING.window * times
    window = np.where(np.any(outside, axis=1), np.argmax(outside, axis=1), steps - 1)
    return np.maximum(np.take_along_axis(times, window[:, None], axis=1)[:, 0], 1.0)


def _split_r_hat(chains: FloatArray) -> float:
    """Potential scale reduction over halves of ensembles; `chains` has shape (ensembles, steps, walkers).

    Gelman et al., Bayesian Data Analysis, 3rd ed., section 11.4, with each half of an ensemble as one chain.
    """
    half = chains.shape[1] // 2
    parts = np.concatenate([chains[:, :half], chains[:, half : 2 * half]]).reshape(2 * chains.shape[0], -1)
    within = float(np.mean(np.var(parts, axis=1, ddof=1)))
    between = float(np.var(np.mean(parts, axis=1), ddof=1))
    if within <= 0.0:
        return float("inf")
    return float(np.sqrt((parts.shape[1] - 1) / parts.shape[1] + between / within))

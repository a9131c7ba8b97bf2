"""Updates by least squares: the paper's method and a uniform change of the properties.

The paper's method has no gravity and starts from the standard beam. Its factors on the width and thickness of each
element, on density and on modulus, 42 for 20 elements, lie between 1 - bound and 1 + bound (10 % in the paper). Of the
many solutions the one nearest to the start is chosen: undetermined factors do not change. `smallest_bound` is the least
bound with an exact fit. `update_uniform` also gives the combinations of properties that the data determine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy  # its parts are loaded when they are used
from scipy.linalg import solve_triangular

from sim.beam import BeamProperties
from sim.updating.family import BeamFamily
from sim.updating.measured_modes import MeasuredModes
from tracker import FloatArray, IntArray, checked


@dataclass(frozen=True)
class Tuning:
    """Least squares within a bound, linear programs, and what counts as known."""

    #: [sd per bound] weight of the distance from the start against the misfits
    #: physics: Determines only what the data do not; it shifts the frequencies by less than 1e-7.
    pull: float = 0.01
    #: [1] Gauss-Newton iterations, here and to the maximum of a posterior
    iterations: int = 40
    #: [1] share of a step below which it is not halved again: the point counts as the solution
    #: convention: Nine halvings; chosen.
    smallest_share: float = 1e-3
    #: [1] largest change of a factor at convergence; of a number of the posterior, in sd of its prior
    #: physics: A hundredth of model_sd. The error of a log evidence is its square times the precision of the data, 1e6.
    settled: float = 1e-6
    #: [1] largest bound that the linear programs may reach; beyond, there is none
    #: physics: A factor below 0.1 has no meaning.
    largest_bound: float = 0.9
    #: [1] trust region of the linear programs at the start and at most, as a change of a factor
    #: convention: Chosen: frequencies are close to linear in the logarithms over some per cent.
    first_reach: float = 0.2
    #: [1] growth of the trust region after a program that improved
    grows: float = 2.0
    #: [1] factor on the trust region after one that did not
    shrinks: float = 0.25
    #: [1] trust region below which the programs end
    #: physics: A tenth of the accuracy at which the frequencies count as reached.
    smallest_reach: float = 1e-8
    #: [1] gain below which the programs end
    #: physics: A hundred-millionth of a bound of 10 %: below what is printed.
    smallest_gain: float = 1e-9
    #: [1] linear programs at one price
    programs: int = 100
    #: [1] relative deviation of every frequency below which they count as reached
    #: physics: A thousandth of model_sd.
    reached: float = 1e-7
    #: [1 / bound] first penalty of a relative deviation of a frequency
    #: convention: Chosen: frequencies change about as the factors do, so that a price above 1 suffices where they are
    #: linear.
    price: float = 2.0
    #: [1] growth of the penalty where the frequencies are not reached
    price_growth: float = 5.0
    #: [1] penalties tried before no bound is found
    prices: int = 3
    #: [1] further random starts, whose scatter shows what the data leave open
    #: convention: Limits the computing time: each costs as much as the update.
    other_starts: int = 4
    #: [1] sd of a combination over the bound below which it counts as determined
    #: physics: Half the bound is the sd of the prior: the data then say more.
    known_share: float = 0.5
    #: [1] relative sd of every frequency for the uniform update
    #: convention: A uniform beam misfits by some per cent, so all modes have equal weight whatever their precision.
    discrepancy: float = 0.03
    #: [1] singular value over the largest below which a combination counts as undetermined
    #: physics: Above the rounding of exact slopes; chosen.
    rounding: float = 1e-9


TUNING = Tuning()


@dataclass(frozen=True)
class Misfit:
    """Deviation of a beam's modes from measured ones, over standard deviations, as a function of the factors."""

    family: BeamFamily
    measured: MeasuredModes

    @classmethod
    def of(
        cls, properties: BeamProperties, measured: MeasuredModes, bodies: int = 0, *, clamp: bool = False
    ) -> Misfit:
        """Misfit of the family of `properties`, whose last `bodies` point masses, or `clamp`, are unknown."""
        return cls(BeamFamily(properties, measured.highest, measured.shapes, bodies, clamp), measured)

    @cached_property
    def root(self) -> FloatArray:
        """Lower Cholesky factor, shape (m, m), of the covariance of the logarithms of the measured frequencies.

        It includes the error of the mesh, and that of the camera's frame rate, which is common to all.
        """
        # cubic elements are too stiff by (beta h)^4 / 1440, with beta L near (r - 1/2) pi
        across = (self.measured.mode_numbers - 0.5) * np.pi / self.family.standard.elements
        own = np.hypot(self.measured.relative_sd, across**4 / 1440.0)
        if self.measured.rate_sd == 0.0:
            return np.diag(own)
        return np.asarray(np.linalg.cholesky(np.diag(own**2) + self.measured.rate_sd**2))

    @property
    def log_normalisation(self) -> float:
        """Logarithm of the density of the measured values where every misfit is zero.

        For the logarithms of the frequencies and the values of a shape over the largest; the free scale of a shape
        removes one dimension.
        """
        total = -float(np.sum(np.log(np.sqrt(2.0 * np.pi) * np.diag(self.root))))
        for shape in self.measured.shapes:
            relative = shape.total_sd / float(np.max(np.abs(shape.amplitude)))
            mean = float(np.mean(np.log(np.sqrt(2.0 * np.pi) * relative)))
            total -= (relative.size - 1) * mean
        return total

    def frequency_hz(self, factor: FloatArray) -> FloatArray:
        """Frequencies of the measured modes, shape (m,)."""
        modes = self.family.modes(np.log(factor))
        return np.asarray(modes.frequency_hz[0, self.measured.mode_numbers - 1])

    def shape_rms(self, factor: FloatArray) -> float:
        """Deviation of the measured shapes over their standard deviations, rms over all points; NaN without shapes."""
        values = self.at(np.log(factor))[0][0, self.measured.mode_numbers.size :]
        return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")

    def at(self, log_factor: FloatArray, *, slopes: bool = False) -> tuple[FloatArray, FloatArray]:
        """Misfits, shape (n, k), and their derivatives by the log factors, (n, k, v) or (n, 0, v).

        Frequencies first, ``log(f / f_measured)`` divided by `root`; then each measured shape with free scale and sign.
        """
        modes = self.family.modes(log_factor, slopes=slopes)
        at = self.measured.mode_numbers - 1
        off = np.log(modes.frequency_hz[:, at] / self.measured.frequency_hz)
        # NaN for a beam that buckles
        parts = [solve_triangular(self.root, off.T, lower=True, check_finite=False).T]
        parts += [
            shape.misfit(values) for shape, values in zip(self.measured.shapes, modes.shapes, strict=True)
        ]
        misfit = np.concatenate(parts, axis=1)
        if not slopes:
            return misfit, np.zeros((misfit.shape[0], 0, self.family.variables))
        rows = [np.linalg.solve(self.root, modes.log_frequency_slopes[:, at])]
        for shape, values, change in zip(self.measured.shapes, modes.shapes, modes.shape_slopes, strict=True):
            rows.append(shape.misfit_slopes(values, change))
        return misfit, np.concatenate(rows, axis=1)


def fit_within(misfit: Misfit, start: FloatArray, bound: float, free: FloatArray | None = None) -> FloatArray:
    """Factors within `bound` with the least sum of squared misfits; of several solutions the nearest to `start`.

    Gauss-Newton with exact bounds in each linearised problem, and step halving. All factors are free unless `free`,
    shape (v, k), has their allowed changes in columns; the bound then applies to the multiples of the columns, and
    `start` must be 1.
    """
    columns = np.eye(start.size) if free is None else free
    moved, p = np.zeros(columns.shape[1]), start.copy()
    low, high = (1.0 - bound - start, 1.0 + bound - start) if free is None else (-bound, bound)
    pull = TUNING.pull / bound

    def residual(change: FloatArray) -> FloatArray:
        return np.concatenate([misfit.at(np.log(start + columns @ change))[0][0], pull * change])

    now = residual(moved)
    for _ in range(TUNING.iterations):
        _, slopes = misfit.at(np.log(p), slopes=True)
        rows = np.vstack([slopes[0] / p @ columns, pull * np.eye(moved.size)])
        limits = (np.minimum(low - moved, -1e-13), np.maximum(high - moved, 1e-13))
        move = np.asarray(scipy.optimize.lsq_linear(rows, -now, bounds=limits, method="bvls").x)
        share = 1.0
        while share > TUNING.smallest_share:
            trial = np.clip(moved + share * move, low, high)
            then = residual(trial)
            if then @ then < now @ now:
                break
            share *= 0.5
        else:
            return p
        moved, now = trial, then
        p = start + columns @ moved
        if np.max(np.abs(share * move)) < TUNING.settled:
            break
    return p


def smallest_bound(misfit: Misfit) -> tuple[float, FloatArray]:
    """Smallest bound on the change of any factor with which all measured frequencies are reached exactly.

    Successive linear programs from the standard beam, each minimising the bound with linearised frequencies within a
    trust region. Measured shapes are ignored. The optimum is a local one.

    Returns
    -------
    bound : float
        NaN if there is none below 0.9.
    factor : array, shape (v,)
    """
    p = np.ones(misfit.family.variables)
    for k in range(TUNING.prices):
        p, off = _programs(misfit, p, TUNING.price * TUNING.price_growth**k)
        if np.max(np.abs(off)) < TUNING.reached:
            return float(np.max(np.abs(p - 1.0))), p
    return float("nan"), p


def _programs(misfit: Misfit, p: FloatArray, price: float) -> tuple[FloatArray, FloatArray]:
    """Successive linear programs from `p`; factors, and remaining deviations of the frequencies."""
    reach = TUNING.first_reach
    off, rows = _deviations(misfit, p)
    for _ in range(TUNING.programs):
        step = _bounded_program(p, off, rows, reach, price)
        if step is None:
            break
        trial = p + step
        then, then_rows = _deviations(misfit, trial)
        gain = _merit(p, off, price) - _merit(trial, then, price)
        if gain > 0.0:
            p, off, rows = trial, then, then_rows
            reach = min(TUNING.grows * reach, TUNING.first_reach)
        else:
            reach *= TUNING.shrinks
        if 0.0 < gain < TUNING.smallest_gain or reach < TUNING.smallest_reach:
            break
    return p, off


def _deviations(misfit: Misfit, p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Log ratios of the frequencies to the measured ones, shape (m,), and their derivatives by the factors, (m, v)."""
    values, slopes = misfit.at(np.log(p), slopes=True)
    m = misfit.measured.mode_numbers.size
    return misfit.root @ values[0, :m], misfit.root @ slopes[0, :m] / p


def _merit(p: FloatArray, off: FloatArray, price: float) -> float:
    """Bound of the factors plus the penalty of the deviations."""
    return float(np.max(np.abs(p - 1.0)) + price * np.sum(np.abs(off)))


def _bounded_program(
    p: FloatArray, off: FloatArray, rows: FloatArray, reach: float, price: float
) -> FloatArray | None:
    """Step within `reach` that minimises bound and penalty of the linearised problem; None if there is none."""
    size, m = p.size, off.size
    one, none = np.ones((size, 1)), np.zeros((size, 2 * m))
    solved = scipy.optimize.linprog(
        np.concatenate([np.zeros(size), [1.0], np.full(2 * m, price)]),
        A_ub=np.vstack([np.hstack([np.eye(size), -one, none]), np.hstack([-np.eye(size), -one, none])]),
        b_ub=np.concatenate([1.0 - p, p - 1.0]),
        A_eq=np.hstack([rows, np.zeros((m, 1)), np.eye(m), -np.eye(m)]),
        b_eq=-off,
        bounds=[(-reach, reach)] * size + [(0.0, TUNING.largest_bound)] + [(0.0, None)] * (2 * m),
    )
    return np.asarray(solved.x[:size]) if solved.success else None


@dataclass(frozen=True)
class PaperUpdate:
    """Beam without gravity that fits the measured frequencies and shapes by least squares within a bound.

    Attributes
    ----------
    properties : BeamProperties
        Without gravity (``orientation = "none"``).
    standard_hz, updated_hz : array, shape (m,)
        Without gravity, before and after.
    width_factor, thickness_factor : array, shape (ne,)
    at_bound : tuple of str
        Names of the variables at their bound.
    smallest_bound : float
        Bound below which the frequencies cannot be reached; NaN if none is found.
    start_spread : array, shape (v,)
        Standard deviation of each factor (widths, thicknesses, density, modulus) over solutions from random starts
        within the bound, which fit equally well.
    shape_rms : float
        Deviation of the measured shapes in standard deviations; NaN without shapes.
    """

    properties: BeamProperties
    mode_numbers: IntArray
    standard_hz: FloatArray
    updated_hz: FloatArray
    width_factor: FloatArray
    thickness_factor: FloatArray
    density_factor: float
    elastic_modulus_factor: float
    bound: float
    at_bound: tuple[str, ...]
    smallest_bound: float
    start_spread: FloatArray
    shape_rms: float = float("nan")


def update_like_paper(
    properties: BeamProperties, measured: MeasuredModes, *, bound: float = 0.10, seed: int = 0
) -> PaperUpdate:
    """Fit widths, thicknesses, density and modulus within `bound` to the measured modes, without gravity.

    Minimises the sum of squared deviations of frequencies and shapes over their standard deviations. The problem has
    infinitely many solutions; the one nearest to the standard beam is returned. Point masses are kept; `seed` is that
    of the random starts.

    Raises
    ------
    ValueError
        If the bound is not between 0 and 0.5.
    """
    checked("bound", bound, positive=True, at_most=0.5)
    standard = replace(properties, orientation="none", angle_deg=None)
    misfit = Misfit.of(standard, measured)
    ne, one = standard.elements, np.ones(misfit.family.variables)
    p = fit_within(misfit, one, bound)
    rng = np.random.default_rng(seed)
    starts = rng.uniform(1.0 - bound, 1.0 + bound, (TUNING.other_starts, one.size))
    others = np.array([fit_within(misfit, start, bound) for start in starts])
    return PaperUpdate(
        properties=misfit.family.properties(np.log(p)),
        mode_numbers=measured.mode_numbers,
        standard_hz=misfit.frequency_hz(one),
        updated_hz=misfit.frequency_hz(p),
        width_factor=p[:ne].copy(),
        thickness_factor=p[ne : 2 * ne].copy(),
        density_factor=float(p[-2]),
        elastic_modulus_factor=float(p[-1]),
        bound=bound,
        at_bound=_names_at_bound(p, bound),
        smallest_bound=smallest_bound(misfit)[0],
        start_spread=np.std(others, axis=0, ddof=1),
        shape_rms=misfit.shape_rms(p),
    )


def variable_names(elements: int) -> tuple[str, ...]:
    """Names of the variables in order: widths and thicknesses from the clamp on, density, modulus."""
    fields = [f"{name} of element {e + 1}" for name in ("width", "thickness") for e in range(elements)]
    return (*fields, "density", "elastic modulus")


def _names_at_bound(p: FloatArray, bound: float) -> tuple[str, ...]:
    at = np.abs(np.abs(p - 1.0) - bound) < TUNING.settled
    names = variable_names((p.size - 2) // 2)
    return tuple(f"{names[i]} ({100 * (p[i] - 1.0):+.0f} %)" for i in np.flatnonzero(at))


@dataclass(frozen=True)
class UniformUpdate:
    """Uniform change of the properties with the least misfit, with gravity and equal weight of all modes.

    Frequencies and shapes of a uniform beam without point masses depend on E h^2 / rho only (and on length and
    gravity): they do not determine the width, nor E, h and rho separately.

    Attributes
    ----------
    properties : BeamProperties
        With a changed thickness only.
    standard_hz, updated_hz : array, shape (m,)
    thickness_factor, stiffness_factor : float
        Factor on the thickness; its square, the factor on E h^2 / rho.
    combinations : array, shape (4, 4)
        Orthonormal rows: exponents of width, thickness, density and modulus in the combinations that the data
        distinguish, the best determined first.
    combination_sd : array, shape (4,)
        Standard deviation of the logarithm of each; infinite where undetermined.
    known : int
        Number of combinations with a standard deviation below half the bound.
    largest_error : float
        Largest remaining relative deviation of a frequency.
    shape_rms : float
        Deviation of the measured shapes in standard deviations; NaN without shapes.
    """

    properties: BeamProperties
    standard_hz: FloatArray
    updated_hz: FloatArray
    thickness_factor: float
    stiffness_factor: float
    combinations: FloatArray
    combination_sd: FloatArray
    known: int
    largest_error: float
    shape_rms: float


def update_uniform(
    properties: BeamProperties, measured: MeasuredModes, *, bound: float = 0.10
) -> UniformUpdate:
    """Best uniform change of the beam under gravity, of at most `bound`, and the combinations that the data determine.

    Raises
    ------
    ValueError
        If the bound is not between 0 and 0.5.
    BuckledBeamError
        If a standing beam cannot carry its own weight.
    """
    checked("bound", bound, positive=True, at_most=0.5)
    misfit = Misfit.of(properties, measured)
    spread = uniform_basis(properties.elements)
    one = np.ones(misfit.family.variables)
    with_discrepancy = Misfit.of(
        properties, replace(measured, model_sd=max(TUNING.discrepancy, measured.model_sd))
    )
    p = fit_within(with_discrepancy, one, bound, spread[:, [1]])
    _, slopes = misfit.at(np.log(p), slopes=True)
    rows = slopes[0] @ spread
    _, values, combinations = np.linalg.svd(rows, full_matrices=True)
    singular = np.zeros(4)
    singular[: values.size] = np.where(values > TUNING.rounding * values[0], values, 0.0)
    with np.errstate(divide="ignore"):
        sd = 1.0 / singular
    signs = np.sign(combinations[np.arange(4), np.argmax(np.abs(combinations), axis=1)])
    factor = float(p[properties.elements])
    updated_hz = misfit.frequency_hz(p)
    return UniformUpdate(
        properties=misfit.family.properties(np.log(p)),
        standard_hz=misfit.frequency_hz(one),
        updated_hz=updated_hz,
        thickness_factor=factor,
        stiffness_factor=factor**2,
        combinations=combinations * signs[:, np.newaxis],
        combination_sd=sd,
        known=int(np.count_nonzero(sd < TUNING.known_share * bound)),
        largest_error=float(np.max(np.abs(updated_hz / measured.frequency_hz - 1.0))),
        shape_rms=misfit.shape_rms(p),
    )


def uniform_basis(elements: int) -> FloatArray:
    """Matrix from (width, thickness, density, modulus) to all variables, shape (2 ne + 2, 4)."""
    out = np.zeros((2 * elements + 2, 4))
    out[:elements, 0] = out[elements : 2 * elements, 1] = 1.0
    out[-2, 2] = out[-1, 3] = 1.0
    return out

r"""Damping laws: the damping ratio as a function of frequency, with posterior and evidence over measured modes.

A law predicts :math:`\ln \zeta_k = \ln A + \ln g(\omega_k; p)`. A measured mode differs from it by its own error, of
relative standard deviation :math:`\sigma_k / \zeta_k`, and by a scatter :math:`s` between modes, the error of every
law: both normal in :math:`\ln \zeta`, which is crude above 30 %. Priors, the same for all laws: level
:math:`\ln A \sim N(\ln 0.003, 2^2)` at the reference frequency, the geometric mean of the measured ones, scatter
uniform in :math:`\ln s` from 1 % to 100 %, and that of the parameter p stated by its law. The level is linear and
integrated exactly; p and s by quadrature on fixed nodes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from sim.damping.models import DampingModel, GenericDamping
from tracker import INTERVAL_SD, FloatArray

if TYPE_CHECKING:
    from sim.damping.entry import BeamSection, MeasuredDamping


@dataclass(frozen=True)
class Tuning:
    """Priors that all laws share, and the nodes of the quadrature."""

    #: [1] median of the prior of the damping ratio at the reference frequency
    #: convention: Between bare metal (1e-4) and plastics (0.1); chosen.
    level: float = 0.003
    #: [1] its standard deviation in the natural logarithm
    #: convention: 90 % of the prior lies between 1e-4 and 8 %; chosen.
    level_sd: float = 2.0
    #: [1] smallest scatter between modes
    #: convention: No law holds better: clamps and amplitudes differ by as much between recordings; chosen.
    least_scatter: float = 0.01
    #: [1] largest scatter
    #: convention: A law that is wrong by a factor of e predicts nothing; chosen.
    largest_scatter: float = 1.0
    #: [1] nodes of the scatter, in equal ratios
    #: measurement: Twice as many change no log evidence by 0.05 (tests/sim/damping/test_laws.py).
    scatters: int = 16
    #: [1] distance of nodes of a level or a ratio of levels, in its natural logarithm
    #: measurement: Half of it changes no log evidence by 0.05 (tests/sim/damping/test_laws.py).
    spacing: float = 0.01


TUNING = Tuning()
_NOTHING = (float("nan"),) * 3


@dataclass(frozen=True)
class LeftOut:
    """A mode as the others predict it: log density of its measured ln zeta, true damping ratio with 90 % interval."""

    log_density: float
    damping_ratio: float
    q05: float
    q95: float


@dataclass(frozen=True)
class LawFit:
    """A law over measured modes.

    Attributes
    ----------
    log_evidence : float
        Log of the density of the measured ln zeta, integrated over the priors.
    parameters : int
        Free ones beside the scatter.
    left_out : tuple of LeftOut
        Each mode, by the law fitted to the others.
    level : tuple of float
        Median, 5 % and 95 % quantile of the damping ratio at the reference frequency; NaN without a parameter.
    shape, scatter : tuple of float
        Mean and standard deviation of the law's other parameter and of the scatter; NaN where there is none.
    """

    log_evidence: float
    parameters: int
    left_out: tuple[LeftOut, ...]
    level: tuple[float, ...] = _NOTHING
    shape: tuple[float, ...] = _NOTHING[:2]
    scatter: tuple[float, ...] = _NOTHING[:2]


class DampingLaw(ABC):
    """A damping ratio over frequency; its methods raise ValueError for a damping ratio that is not positive."""

    #: Name of the parameter beside the level.
    shape_name: str = ""

    def lacks(self, section: BeamSection | None) -> str:  # noqa: ARG002 - of laws that need none
        """What the law needs to know of the beam and is not given; empty where it can be used."""
        return ""

    @abstractmethod
    def log_evidence(self, measured: MeasuredDamping) -> float:
        """Log of the density of the measured ln zeta, integrated over the priors."""

    @abstractmethod
    def fit(self, measured: MeasuredDamping) -> LawFit:
        """Evidence, parameters, and predictions of each mode left out, of at least two."""

    @abstractmethod
    def damping_ratio(self, measured: MeasuredDamping, omega_rad_s: FloatArray) -> FloatArray:
        """Damping ratio at these frequencies by the law fitted to measured modes, the median of its posterior."""

    def model(self, measured: MeasuredDamping, omega_rad_s: FloatArray) -> DampingModel:
        """Model for a simulation, which takes a damping ratio for each mode: the law needs no form in time."""
        return GenericDamping(tuple(map(float, self.damping_ratio(measured, omega_rad_s))))


class ParametricLaw(DampingLaw):
    """A law of at most a level and one more parameter."""

    free_level: bool = True

    def nodes(self) -> tuple[FloatArray, FloatArray]:
        """Values of the parameter beside the level, and their prior probabilities, both of shape (q,)."""
        return np.zeros(1), np.ones(1)

    @abstractmethod
    def log_ratio(self, omega: FloatArray, reference: float, section: BeamSection | None) -> FloatArray:
        """Ln zeta for each node, shape (q, n): for a level of 1 at the reference, or without one as it is."""

    def log_evidence(self, measured: MeasuredDamping) -> float:
        """Sum over the nodes."""
        return _Posterior(self, measured).log_evidence

    def fit(self, measured: MeasuredDamping) -> LawFit:
        """The density of a mode left out is the ratio of the evidences with and without it."""
        omega, y, _ = log_data(measured)
        found, reference = _Posterior(self, measured), float(np.exp(np.mean(np.log(omega))))
        left_out = []
        for at in range(y.size):
            others = _Posterior(self, measured, without=at)
            predicted = _interval(*others.moments(omega[at], scatter=True))
            left_out.append(LeftOut(found.log_evidence - others.log_evidence, *predicted))
        nodes = self.nodes()[0]
        parameters = int(self.free_level) + (nodes.size > 1)
        return LawFit(
            found.log_evidence,
            parameters,
            tuple(left_out),
            _interval(*found.moments(reference)) if parameters else _NOTHING,
            found.marginal(nodes, 1) if nodes.size > 1 else _NOTHING[:2],
            found.marginal(scatters(), 0),
        )

    def damping_ratio(self, measured: MeasuredDamping, omega_rad_s: FloatArray) -> FloatArray:
        """Exponential of the mean of ln zeta."""
        found = _Posterior(self, measured)
        return np.array([np.exp(found.moments(omega)[0]) for omega in omega_rad_s])


class PowerLaw(ParametricLaw):
    """A damping ratio proportional to a power of the frequency."""

    def __init__(self, power: float) -> None:
        self.power = power

    def log_ratio(self, omega: FloatArray, reference: float, section: BeamSection | None) -> FloatArray:  # noqa: ARG002
        """Power times the logarithm of the frequency."""
        return np.asarray(self.power * np.log(omega / reference)[np.newaxis])


class ComputedLaw(ParametricLaw):
    """A law without a free parameter, computed from the section of the beam and, if it `needs_material`, from that."""

    free_level = False

    def __init__(
        self, ratio: Callable[[FloatArray, BeamSection], FloatArray], *, needs_material: bool
    ) -> None:
        self._ratio, self._needs_material = ratio, needs_material

    def lacks(self, section: BeamSection | None) -> str:
        """The section, or its material."""
        if section is None:
            return "the section of the beam"
        return "[beam] material" if self._needs_material and section.material is None else ""

    def log_ratio(self, omega: FloatArray, reference: float, section: BeamSection | None) -> FloatArray:  # noqa: ARG002
        """As computed; ValueError for a section that lacks something."""
        if section is None or self.lacks(section):
            msg = f"expected {self.lacks(section)}, found none"
            raise ValueError(msg)
        return np.log(self._ratio(omega, section))[np.newaxis]


class _Posterior:
    """Posterior over nodes (rows) and scatters (columns), normal in the level; the reference is that of all modes."""

    def __init__(self, law: ParametricLaw, measured: MeasuredDamping, without: int = -1) -> None:
        omega, y, relative_sd = log_data(measured)
        reference = float(np.exp(np.mean(np.log(omega))))
        used = np.arange(y.size) != without
        self._curve = partial(law.log_ratio, reference=reference, section=measured.section)
        # sums over modes are products of matrices: nodes by modes, modes by scatters
        weight = 1.0 / (relative_sd**2 + scatters()[:, np.newaxis] ** 2)[:, used]
        rest = y[used] - self._curve(omega[used])
        log = 0.5 * (np.log(weight / (2.0 * np.pi)).sum(axis=1) - rest**2 @ weight.T)
        log += np.log(law.nodes()[1])[:, np.newaxis] - np.log(TUNING.scatters)
        self._mean, self._level_variance = np.zeros_like(log), np.zeros(TUNING.scatters)
        if law.free_level:
            own, centre, total = 1.0 / TUNING.level_sd**2, np.log(TUNING.level), weight.sum(axis=1)
            self._mean, self._level_variance = (
                (rest @ weight.T + own * centre) / (total + own),
                1.0 / (total + own),
            )
            log += 0.5 * ((total + own) * self._mean**2 - own * centre**2 - np.log((total + own) / own))
        self.log_evidence = float(np.logaddexp.reduce(log, axis=None))
        self._weight = np.exp(log - self.log_evidence)

    def moments(self, omega: float, *, scatter: bool = False) -> tuple[float, float]:
        """Mean and standard deviation of ln zeta at a frequency."""
        value = self._curve(np.array([omega])) + self._mean
        mean = float(np.sum(self._weight * value))
        within = self._level_variance + (scatters() ** 2 if scatter else 0.0)
        return mean, float(np.sqrt(np.sum(self._weight * ((value - mean) ** 2 + within))))

    def marginal(self, values: FloatArray, axis: int) -> tuple[float, float]:
        """Mean and standard deviation of the nodes or the scatters."""
        weight = self._weight.sum(axis=axis)
        mean = float(weight @ values)
        return mean, float(np.sqrt(weight @ (values - mean) ** 2))


def _interval(middle: float, sd: float) -> tuple[float, float, float]:
    """Median, 5 % and 95 % quantile of a damping ratio whose logarithm is normal."""
    median, low, high = np.exp(middle + INTERVAL_SD * sd * np.array([0.0, -1.0, 1.0]))
    return float(median), float(low), float(high)


def log_data(measured: MeasuredDamping) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angular frequency, ln zeta and its standard deviation of the measured modes, each of shape (n,)."""
    zeta = np.array(measured.damping_ratio)
    if not np.all(zeta > 0.0):
        msg = f"a damping law needs positive damping ratios, got {measured.damping_ratio}"
        raise ValueError(msg)
    sd = np.array(measured.damping_sd) if measured.damping_sd else np.zeros_like(zeta)
    return 2.0 * np.pi * np.array(measured.frequency_hz), np.log(zeta), sd / zeta


def scatters() -> FloatArray:
    """Nodes of the scatter between modes, of equal prior probability."""
    low, high = np.log([TUNING.least_scatter, TUNING.largest_scatter])
    return np.asarray(np.exp(low + (np.arange(TUNING.scatters) + 0.5) / TUNING.scatters * (high - low)))


def normal_nodes(mean: float, sd: float) -> tuple[FloatArray, FloatArray]:
    """Equally spaced nodes over four standard deviations of a normal prior, and their probabilities."""
    half = int(np.ceil(4.0 * sd / TUNING.spacing))
    nodes = np.arange(-half, half + 1) * TUNING.spacing
    weight = np.exp(-0.5 * (nodes / sd) ** 2)
    return np.asarray(mean + nodes), np.asarray(weight / weight.sum())


def neighbour_weights(known: FloatArray, omega: FloatArray) -> FloatArray:
    """Weight of each known damping ratio in that at `omega`, shape (m, n): linear, constant outside."""
    return np.stack([np.interp(omega, known, unit) for unit in np.eye(known.size)], axis=1)


@dataclass(frozen=True)
class ThroughAllModes(DampingLaw):
    """An interpolation of all measured damping ratios by their weights.

    The values are the parameters, independent, with the prior of a level. What such a law says of a mode left out is
    its interpolation through the others, normal about it with the scatter of the prior.
    """

    weights: Callable[[FloatArray, FloatArray], FloatArray] = neighbour_weights

    def log_evidence(self, measured: MeasuredDamping) -> float:
        """Of independent values."""
        _, y, relative_sd = log_data(measured)
        return float(_log_normal(y, np.log(TUNING.level), np.hypot(TUNING.level_sd, relative_sd)).sum())

    def fit(self, measured: MeasuredDamping) -> LawFit:
        """The values themselves."""
        left_out = [self._left_out(measured, at) for at in range(len(measured.numbers))]
        return LawFit(self.log_evidence(measured), len(left_out), tuple(left_out))

    def damping_ratio(self, measured: MeasuredDamping, omega_rad_s: FloatArray) -> FloatArray:
        """The interpolation; Caughey's series may be negative between the modes."""
        omega, y, _ = log_data(measured)
        return np.asarray(self.weights(omega, np.asarray(omega_rad_s)) @ np.exp(y))

    def _left_out(self, measured: MeasuredDamping, at: int) -> LeftOut:
        omega, y, relative_sd = log_data(measured)
        zeta, rest = np.exp(y), np.arange(y.size) != at
        parts = self.weights(omega[rest], omega[at : at + 1])[0] * zeta[rest]
        mean = float(parts.sum())
        variance = np.add.outer(scatters() ** 2, relative_sd[rest] ** 2) @ parts**2 + (scatters() * mean) ** 2
        density = _log_normal(zeta[at], mean, np.sqrt(variance + (relative_sd[at] * zeta[at]) ** 2)) + y[at]
        reach = INTERVAL_SD * float(np.sqrt(np.mean(variance)))
        log_mean = float(np.logaddexp.reduce(density) - np.log(density.size))
        return LeftOut(log_mean, mean, mean - reach, mean + reach)


def _log_normal(value: FloatArray, mean: float, sd: FloatArray) -> FloatArray:
    return np.asarray(-0.5 * ((value - mean) / sd) ** 2 - np.log(sd * np.sqrt(2.0 * np.pi)))

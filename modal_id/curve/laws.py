"""Laws of decay: how the decay rate and the angular frequency of a mode depend on its amplitude."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import expit

from tracker import FloatArray

# Name of the law without changes.
CONSTANT = "constant"
# Prior of the logarithm of the power of a saturating law.
_LOG_POWER, _POWER_SD = float(np.log(2.0)), 0.7


@dataclass(frozen=True)
class Rates:
    """Decay rate in 1/s and angular frequency in rad/s at given amplitudes, with their derivatives.

    ``decay`` and ``angular`` have shape (n,); ``decay_slopes`` and ``angular_slopes``, shape (n, q), are their
    derivatives with respect to the parameters of the law.
    """

    decay: FloatArray
    angular: FloatArray
    decay_slopes: FloatArray
    angular_slopes: FloatArray

    def first(self, count: int) -> Rates:
        """Rates at the first `count` amplitudes."""
        return Rates(
            self.decay[:count],
            self.angular[:count],
            self.decay_slopes[:count],
            self.angular_slopes[:count],
        )


class Law(ABC):
    """``d ln a / dt = -decay(a)``, ``d phase / dt = angular(a)``; the amplitude a is 1 at the start of the fit.

    The first two parameters of every law are the decay rate and the angular frequency at zero amplitude.

    Attributes
    ----------
    name : str
        Used in report and messages.
    """

    name: str

    @property
    @abstractmethod
    def prior_sd(self) -> FloatArray:
        """Standard deviations of the normal prior of each parameter, infinite for the first two; shape (q,)."""

    @property
    def prior_mean(self) -> FloatArray:
        """Means of the prior, shape (q,): no changes."""
        return np.zeros(self.prior_sd.size)

    @abstractmethod
    def rates(self, amplitude: FloatArray, parameters: FloatArray) -> Rates:
        """Rates at amplitudes from 0 to 1, shape (n,)."""


@dataclass(frozen=True)
class PowerLaw(Law):
    """``value(a) = value_0 + change a^p``, with a power for the decay rate and one for the frequency.

    Powers 1 and 2: quadratic air drag, whose damping ratio is proportional to the amplitude, and large deflections.
    Powers 1 and 1: stiffness and loss of the structure are both linear in the amplitude. Powers 2 and 2: the even
    dependence of a symmetric structure. No powers: Eq. 1.

    Attributes
    ----------
    powers : tuple of float
        Of decay rate and frequency; empty for constant rates.
    decay_sd, angular_sd : float
        Prior standard deviations of the changes, in 1/s and rad/s.
    """

    powers: tuple[float, ...]
    decay_sd: float
    angular_sd: float

    @property
    def name(self) -> str:  # type: ignore[override]  # read-only here
        """States the powers."""
        if not self.powers:
            return CONSTANT
        damping, frequency = ("a" if power == 1.0 else "a²" for power in self.powers)
        return f"ζ linear in {damping}, f linear in {frequency}"

    @property
    def prior_sd(self) -> FloatArray:
        """Of (decay_0, angular_0, change of each)."""
        return np.array([np.inf, np.inf, self.decay_sd, self.angular_sd][: 2 + len(self.powers)])

    def rates(self, amplitude: FloatArray, parameters: FloatArray) -> Rates:
        """As in the class's formula."""
        slopes = np.zeros((2, amplitude.size, 2 + len(self.powers)))
        for of, power in enumerate((0.0, 0.0, *self.powers)):
            slopes[of % 2, :, of] = amplitude**power
        return Rates(slopes[0] @ parameters, slopes[1] @ parameters, slopes[0], slopes[1])


@dataclass(frozen=True)
class StiffnessLaw(Law):
    """``angular(a) = angular_0 + change a^2`` with a constant decay rate.

    Large deflections change the stiffness and not the loss. `angular_sd` is the prior standard deviation of the change,
    in rad/s.
    """

    angular_sd: float
    name: str = "ζ constant, f linear in a²"

    @property
    def prior_sd(self) -> FloatArray:
        """Of (decay_0, angular_0, change)."""
        return np.array([np.inf, np.inf, self.angular_sd])

    def rates(self, amplitude: FloatArray, parameters: FloatArray) -> Rates:
        """As in the class's formula."""
        one, none = np.ones_like(amplitude), np.zeros_like(amplitude)
        decay, angular = np.stack([one, none, none], axis=1), np.stack([none, one, amplitude**2], axis=1)
        return Rates(decay @ parameters, angular @ parameters, decay, angular)


@dataclass(frozen=True)
class SaturatingLaw(Law):
    """``value(a) = value_0 + change a^p / (a^p + s^p)``, with s and p separate for decay rate and frequency.

    Slip in a clamp or joint: it grows with the amplitude until the whole contact slips. A contact without a threshold
    has p = 2, micro-slip p = 1; with a threshold p is larger.

    Attributes
    ----------
    decay_sd, angular_sd : float
        Prior standard deviations of the changes, in 1/s and rad/s.
    lowest : float
        Amplitude above which the record determines the rates: s is expected between it and 1.
    """

    decay_sd: float
    angular_sd: float
    lowest: float
    name: str = "saturating"

    @property
    def prior_sd(self) -> FloatArray:
        """Of (decay_0, angular_0, change of each, logarithm of each s, logarithm of each p)."""
        spread = max(-0.5 * float(np.log(self.lowest)), 0.5)
        return np.array(
            [np.inf, np.inf, self.decay_sd, self.angular_sd, spread, spread, _POWER_SD, _POWER_SD]
        )

    @property
    def prior_mean(self) -> FloatArray:
        """Of the same: s in the middle of the range of amplitudes, p = 2."""
        middle = 0.5 * float(np.log(self.lowest))
        return np.array([0.0, 0.0, 0.0, 0.0, middle, middle, _LOG_POWER, _LOG_POWER])

    def rates(self, amplitude: FloatArray, parameters: FloatArray) -> Rates:
        """As in the class's formula."""
        log_a = np.log(np.maximum(amplitude, 1e-300))
        slopes = np.zeros((2, amplitude.size, 8))
        values = []
        for of in range(2):
            value_0, change, log_s, log_p = parameters[of::2]
            power = np.exp(np.minimum(log_p, 5.0))
            share = expit(power * (log_a - log_s))
            bend = change * share * (1.0 - share) * power
            values.append(value_0 + change * share)
            # At amplitude 0 the product is 0: the bend underflows, and the logarithm is finite.
            columns = (np.ones_like(share), share, -bend, bend * (log_a - log_s))
            slopes[of, :, of::2] = np.stack(columns, axis=1)
        return Rates(values[0], values[1], slopes[0], slopes[1])


@dataclass(frozen=True)
class SplineLaw(Law):
    """Natural cubic splines in ``ln(1 + a / lowest)``: logarithmic above `lowest`, linear in a below it.

    The parameters are the rates at zero amplitude and their increments from knot to knot, each with a normal prior: a
    random walk along the amplitude, which makes the rates smooth and widens them towards amplitudes that the record
    does not reach.

    Attributes
    ----------
    knots : int
        Number of knots, evenly spaced in that variable from amplitude 0 to 1, both included.
    decay_sd, angular_sd : float
        Prior standard deviation of the change of each rate over the whole range.
    lowest : float
        Amplitude of the transition from linear to logarithmic.
    """

    knots: int
    decay_sd: float
    angular_sd: float
    lowest: float
    name: str = "spline"

    @property
    def prior_sd(self) -> FloatArray:
        """Of (decay_0, angular_0, increments of decay, increments of angular)."""
        steps = self.knots - 1
        share = np.full(steps, 1.0 / np.sqrt(steps))
        # Rates approach a limit towards zero amplitude.
        share[0] *= 0.5
        return np.concatenate([[np.inf, np.inf], share * self.decay_sd, share * self.angular_sd])

    @property
    def _positions(self) -> FloatArray:
        """The variable of the splines at each knot; shape (knots,)."""
        return np.linspace(0.0, np.log1p(1.0 / self.lowest), self.knots)

    @property
    def knot_amplitudes(self) -> FloatArray:
        """Amplitude at each knot; shape (knots,)."""
        return np.asarray(self.lowest * np.expm1(self._positions))

    @cached_property
    def _spline(self) -> CubicSpline:
        # Column j is 1 from knot j on: the effect of the increment before it.
        return CubicSpline(self._positions, np.tri(self.knots), bc_type="natural")

    def parameters(self, decay: FloatArray, angular: FloatArray) -> FloatArray:
        """Parameters of the law with these rates at `knot_amplitudes`, shape (knots,) each."""
        return np.concatenate([[decay[0], angular[0]], np.diff(decay), np.diff(angular)])

    def rates(self, amplitude: FloatArray, parameters: FloatArray) -> Rates:
        """As in the class's formula."""
        steps = self.knots - 1
        basis = np.asarray(self._spline(np.log1p(amplitude / self.lowest)))
        none = np.zeros((amplitude.size, 1))
        other = np.zeros((amplitude.size, steps))
        decay_slopes = np.concatenate([basis[:, :1], none, basis[:, 1:], other], axis=1)
        angular_slopes = np.concatenate([none, basis[:, :1], other, basis[:, 1:]], axis=1)
        return Rates(decay_slopes @ parameters, angular_slopes @ parameters, decay_slopes, angular_slopes)

r"""Low-rank terms that make a time step exact for the lowest modes.

With s = -zeta omega + i omega sqrt(1 - zeta^2) and s^ = (2 / h) tanh(s h / 2), terms ``U diag(mu) U^T`` of mass and
``U diag(d) U^T`` of damping, U = M Phi,

.. math::  1 + \mu = \omega^2 / |\hat s|^2, \qquad d = -2 (1 + \mu)\,\mathrm{Re}\,\hat s ,

multiply a small vibration of a mode by exactly e^{s h} in one step. They vanish as h^2. mu acts on the absolute
acceleration, with the base's share scaled so that the response at resonance is exact too; d acts on the velocity
relative to the base.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.beam import BeamModes
from sim.damping import DampingCoefficients
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Which modes are corrected, and where."""

    #: [rad] omega h of a step above which a mode is not corrected
    #: physics: The midpoint rule is off by (omega h)^2 / 12 = 12 % there, and higher modes are not resolved.
    largest_phase: float = 1.2
    #: [1] share of a modal term in the mass part of the tangent below which it is omitted there
    #: physics: An iteration with an approximate tangent converges by about this factor; the solution does not depend on
    #: it.
    smallest_share: float = 0.01


TUNING = Tuning()


@dataclass(frozen=True)
class ModalTerms:
    """Low-rank corrections: rows of U^T, shape (r, ndof); mass and damping for each halving level, (levels, r)."""

    rows: FloatArray
    mass: FloatArray
    damping: FloatArray
    base_force: FloatArray
    phi: FloatArray
    equilibrium: FloatArray
    exponent: ComplexArray
    discrete: ComplexArray

    def discrete_velocity(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Velocity of the scheme that corresponds to the true velocity `v`.

        For a mode, the former is s^ times its displacement, the latter s times.
        """
        return v + self.phi @ (self._exchanged(q, v, self.exponent, self.discrete) - self.rows @ v)

    def true_velocity(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Inverse of `discrete_velocity`."""
        return v + self.phi @ (self._exchanged(q, v, self.discrete, self.exponent) - self.rows @ v)

    def _exchanged(
        self, q: FloatArray, v: FloatArray, given: ComplexArray, wanted: ComplexArray
    ) -> FloatArray:
        """Modal velocities Re(wanted c) of the motion with displacement Re(c) and velocity Re(given c)."""
        displacement, velocity = self.rows @ (q - self.equilibrium), self.rows @ v
        imaginary = (given.real * displacement - velocity) / given.imag
        return np.asarray(wanted.real * displacement - wanted.imag * imaginary)


def modal_terms(
    modes: BeamModes,
    coefficients: DampingCoefficients,
    levels_s: FloatArray,
    target_omega_rad_s: FloatArray | None,
) -> ModalTerms:
    """Corrections that make frequency and damping of each mode exact at each step size."""
    omega = modes.omega_rad_s
    target = omega.copy()
    if target_omega_rad_s is not None:
        target[: target_omega_rad_s.size] = target_omega_rad_s
    fitted = omega * levels_s[0] < TUNING.largest_phase
    omega, target, zeta = omega[fitted], target[fitted], coefficients.damping_ratio[fitted]
    rows = np.ascontiguousarray((modes.beam.mass_matrix() @ modes.phi[:, fitted]).T)
    exponent = target * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
    h = levels_s[:, np.newaxis]
    discrete = 2.0 / h * np.tanh(0.5 * exponent * h)
    ratio = omega**2 / np.abs(discrete) ** 2
    elsewhere = (
        coefficients.mass_1_s + (coefficients.stiffness_s + coefficients.constant_stiffness_s) * omega**2
    )
    phase = 0.5 * target * levels_s[0]
    # with x = omega h / 2, the difference of the base's velocity over a step is the mean acceleration times sin(x) / x,
    # and at resonance the corrected damping acts on a velocity that is smaller by the same factor
    share = (omega / target) ** 2 * (phase / np.sin(phase)) ** 2 - 1.0
    base_force = modes.beam.base_coupling_kg + rows.T @ (share * modes.base_participation()[fitted])
    return ModalTerms(
        rows=rows,
        mass=ratio - 1.0,
        damping=-2.0 * ratio * discrete.real - elsewhere,
        base_force=base_force,
        phi=np.ascontiguousarray(modes.phi[:, fitted]),
        equilibrium=modes.equilibrium,
        exponent=exponent,
        discrete=discrete[0],
    )


def first_that_matters(gain: FloatArray, step_s: FloatArray) -> NDArray[np.int64]:
    """First of the modal terms, (..., r), with a significant share of the tangent's mass part; r where none has."""
    share = np.abs(gain) * step_s[..., np.newaxis] ** 2 > 2.0 * TUNING.smallest_share
    return np.asarray(np.where(np.any(share, axis=-1), np.argmax(share, axis=-1), share.shape[-1]))

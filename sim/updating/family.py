r"""Modes of many beams that differ in widths, thicknesses, density and modulus, with exact sensitivities.

The variables are logarithms of factors on a standard beam: on the width and thickness of each element, on the density
and on the modulus. For a given state q, stiffness, mass and weight are linear in three numbers per element, EI, EA and
rho A, whose logarithms are sums of the variables; sensitivities are computed for these and summed.

For a mode, ``(K - lambda M) phi = 0`` with ``phi^T M phi = 1``, a change of the beam gives

.. math::

   d\lambda_r = \phi_r^T (dK - \lambda_r dM) \phi_r, \qquad
   d\phi_r = \sum_{s \ne r} \phi_s \frac{\phi_s^T (dK - \lambda_r dM) \phi_r}{\lambda_r - \lambda_s}
             - \tfrac12 \phi_r \phi_r^T dM \phi_r ,

summed over all modes of the mesh, without truncation. K is the tangent at the static equilibrium, which depends on the
properties: ``dK = K_p dp + K_q dq``, ``K dq = (F_weight - F_elastic)_p dp``. For a quantity w^T K phi the second part
follows from the adjoint state a, ``K a = d(w^T K phi)/dq``, at the cost of one solution per quantity.

References
----------
Fox, Kapoor, "Rates of change of eigenvalues and eigenvectors", AIAA J. 6 (1968) 2426-2429, doi:10.2514/3.5008.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim.beam import BeamProperties, eigenmodes
from sim.updating.matrices import BeamMatrices, BeamStates, changes
from sim.updating.measured_modes import MeasuredShape
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Memory."""

    #: [beams] beams whose matrices are held in memory at a time
    #: convention: Some MB for 24 elements; results do not depend on it.
    chunk: int = 64


TUNING = Tuning()


@dataclass(frozen=True)
class FamilyModes:
    """Modes of n beams.

    Attributes
    ----------
    frequency_hz : array, shape (n, m)
        NaN for a beam that buckles or has no equilibrium.
    shapes : tuple of array, each shape (n, k)
        Transverse part of the mass-normalised shapes at the given points, of arbitrary sign.
    log_frequency_slopes, shape_slopes : array, shape (n, m, v), and tuple of array, each (n, k, v)
        Derivatives of log f and of the shapes by the logarithms of the factors; (n, 0, v) and empty without slopes.
    """

    frequency_hz: FloatArray
    shapes: tuple[FloatArray, ...]
    log_frequency_slopes: FloatArray
    shape_slopes: tuple[FloatArray, ...]


@dataclass(frozen=True)
class BeamFamily:
    """Beams that differ from a standard one by factors: their lowest `count` modes, and the shapes at `points`.

    The last `bodies` of the standard beam's point masses have a factor each, on mass and rotary inertia, and an unknown
    elastic `clamp` two, on its stiffness against translation and rotation.
    """

    standard: BeamProperties
    count: int
    points: tuple[MeasuredShape, ...] = ()
    bodies: int = 0
    clamp: bool = False

    @cached_property
    def _matrices(self) -> BeamMatrices:
        return BeamMatrices(self.standard, self.bodies, self.clamp)

    @property
    def variables(self) -> int:
        """Number of variables: widths, thicknesses, density, modulus, unknown point masses, and of an unknown clamp."""
        return 2 * self.standard.elements + 2 + self.bodies + 2 * self.clamp

    def properties(self, log_factor: FloatArray) -> BeamProperties:
        """The beam of one set of factors, shape (v,)."""
        ne = self.standard.elements
        factor = np.exp(log_factor)
        masses = factor[2 * ne + 2 : 2 * ne + 2 + self.bodies]
        known = np.ones(len(self.standard.point_masses) - self.bodies)
        return self.standard.scaled(
            width=factor[:ne],
            thickness=factor[ne : 2 * ne],
            density=float(factor[2 * ne]),
            elastic_modulus=float(factor[2 * ne + 1]),
            point_masses=np.append(known, masses),
            clamp=factor[-2:] if self.clamp else None,
        )

    def modes(self, log_factor: FloatArray, *, slopes: bool = False) -> FamilyModes:
        """Modes of the beams whose log factors are the rows of `log_factor`, shape (n, v) or (v,)."""
        u = np.atleast_2d(np.asarray(log_factor, dtype=np.float64))
        parts = [
            self._modes(u[i : i + TUNING.chunk], slopes=slopes) for i in range(0, u.shape[0], TUNING.chunk)
        ]
        if len(parts) == 1:
            return parts[0]
        indices = range(len(self.points))
        return FamilyModes(
            np.concatenate([part.frequency_hz for part in parts]),
            tuple(np.concatenate([part.shapes[i] for part in parts]) for i in indices),
            np.concatenate([part.log_frequency_slopes for part in parts]),
            tuple(np.concatenate([part.shape_slopes[i] for part in parts]) for i in indices if slopes),
        )

    @cached_property
    def _readings(self) -> tuple[FloatArray, ...]:
        """Transverse displacement at each mode's points of the vibrating coordinates, shape (k, d) each."""
        return tuple(self._matrices.reading(point.positions_m) for point in self.points)

    def _modes(self, u: FloatArray, *, slopes: bool) -> FamilyModes:
        state = self._matrices.state(u)
        square, phi = self._solve(state)
        rigid = len(self.standard.rigid_body_motions)
        bending = slice(rigid, rigid + self.count)
        first = phi[:, :, bending]
        own = np.swapaxes(first, 1, 2)
        moved = self._matrices.full(own, self._matrices.modal)
        known = self._matrices.beam.second_variation(state.q, moved, state.bend, state.axial, state.grip)
        known = np.where((square[:, bending] > 0.0) & (known > 0.0), known, np.nan)
        frequency = np.sqrt(known) / (2.0 * np.pi)
        readings = self._readings
        shapes = tuple(
            np.einsum("kd,nd->nk", reading, first[:, :, point.mode_number - 1])
            for reading, point in zip(readings, self.points, strict=True)
        )
        if not slopes:
            return FamilyModes(frequency, shapes, np.zeros((u.shape[0], 0, u.shape[1])), ())
        mixed = [
            self._mixture(reading, square, phi, rigid + point.mode_number - 1)
            for reading, point in zip(readings, self.points, strict=True)
        ]
        # one call for all frequencies and all points of all shapes
        of_mode = np.concatenate(
            [np.arange(self.count), *(np.full(p.positions_m.size, p.mode_number - 1) for p in self.points)]
        )
        left = np.concatenate([own, *mixed], axis=1)
        change, kinetic = changes(self._matrices, state, left, own[:, of_mode], known[:, of_mode])
        ends = np.cumsum([self.count, *(point.positions_m.size for point in self.points)])
        return FamilyModes(
            frequency,
            shapes,
            0.5 * change[:, : self.count] / known[:, :, np.newaxis],
            tuple(
                change[:, start:end] - 0.5 * values[:, :, np.newaxis] * kinetic[:, [point.mode_number - 1]]
                for start, end, point, values in zip(ends[:-1], ends[1:], self.points, shapes, strict=True)
            ),
        )

    @staticmethod
    def _mixture(reading: FloatArray, square: FloatArray, phi: FloatArray, r: int) -> FloatArray:
        """Sum over the other modes of their values at the points, over the eigenvalue distances; shape (n, k, d)."""
        distance = square[:, [r]] - square
        distance[:, r] = np.inf
        return np.asarray(((reading @ phi) / distance[:, np.newaxis]) @ np.swapaxes(phi, 1, 2))

    def _solve(self, state: BeamStates) -> tuple[FloatArray, FloatArray]:
        """Squares of the angular frequencies, (n, d), and mass-normalised shapes, (n, d, d); bending modes first."""
        scale = self._matrices.scale(self._matrices.modal)
        lost = ~np.all(np.isfinite(state.modal_k), axis=(1, 2))
        stiffness = np.where(lost[:, np.newaxis, np.newaxis], 0.0, state.modal_k)
        stretch = None if state.stretch_k is None else np.nan_to_num(state.stretch_k)
        square, phi = eigenmodes(stiffness, state.modal_m, scale, stretch)
        square[lost] = np.nan
        return square, phi

"""Stiffness, mass and equilibrium of many beams at once, from EI, EA and rho A of each element.

The element is that of `sim.beam.ancf`; here NumPy assembles n beams together, with real or complex numbers. The
coordinates of a beam, those of the clamp included, are ordered by node: (axial, transverse, axial slope, transverse
slope); those "of one direction" are (displacement, slope).

Where gravity does not bend the beam (hanging, standing, none), the equilibrium is axial and the modes are transverse,
so that both problems have half the size.

`changes` has the derivatives of ``left^T (K - square M) right`` with respect to the factors, with the change of the
equilibrium; `sim.updating.family` has the equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.beam import AncfBeam, BeamProperties, ancf, shape_functions, static_equilibrium, statics
from tracker import FloatArray

# of real or complex numbers
Array = NDArray[Any]


_STRAIGHT = ("hanging", "standing", "none")


@dataclass(frozen=True)
class BeamStates:
    """Matrices of n beams at their equilibria.

    Attributes
    ----------
    bend, axial, mass : array, shape (n, ne)
        EI, EA and rho A of each element.
    body : array, shape (n, b)
        Factors of the unknown point masses.
    grip : array, shape (n, 2)
        Factors on the stiffness of the clamp against translation and rotation.
    q : array, shape (n, 4 (ne + 1))
        Equilibria; NaN where there is none.
    static_k : array, shape (n, c, c)
        Tangent over the free coordinates of the equilibrium.
    modal_k, modal_m, stretch_k : array, shape (n, d, d)
        Tangent, mass and axial part of the tangent over the vibrating coordinates, the last None where the vibration is
        transverse.
    """

    bend: Array
    axial: Array
    mass: Array
    body: Array
    grip: Array
    q: Array
    static_k: Array
    modal_k: Array
    modal_m: Array
    stretch_k: Array | None


@dataclass(frozen=True)
class BeamMatrices:
    """Matrices of beams that differ from a standard one by factors.

    Its last `bodies` point masses have one each, and an unknown `clamp` two.
    """

    standard: BeamProperties
    bodies: int = 0
    clamp: bool = False

    @cached_property
    def beam(self) -> AncfBeam:
        """The standard beam."""
        return AncfBeam(self.standard)

    @cached_property
    def gradient(self) -> FloatArray:
        """First derivatives of the shape functions at the Gauss points, shape (g, 4)."""
        return self.beam.dshape

    @cached_property
    def units(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Integrals of N''N'' and N N over an element, (4, 4), and of N, (4,)."""
        h = self.beam.element_length_m
        nodes, weights = np.polynomial.legendre.leggauss(4)
        value = 0.5 * h * weights @ shape_functions(0.5 * (nodes + 1.0), h)
        return self.beam.integral(2, 4), self.beam.integral(0, 4), value

    @cached_property
    def straight(self) -> bool:
        """Whether gravity leaves the beams straight."""
        return self.standard.orientation in _STRAIGHT or self.standard.gravity_m_s2 == 0.0

    @cached_property
    def static(self) -> tuple[int, ...]:
        """Directions (0 axial, 1 transverse) of the equilibrium."""
        return (0,) if self.straight else (0, 1)

    @cached_property
    def modal(self) -> tuple[int, ...]:
        """Directions of the vibration."""
        return (1,) if self.straight else (0, 1)

    def scale(self, directions: tuple[int, ...]) -> FloatArray:
        """Displacement in m that corresponds to one unit of each free coordinate of some directions."""
        return np.where(self.free(directions) % 4 < 2, 1.0, self.beam.element_length_m)

    def free(self, directions: tuple[int, ...]) -> NDArray[np.int64]:
        """Indices of the free coordinates of some directions among all."""
        return self._free[directions]

    @cached_property
    def _free(self) -> dict[tuple[int, ...], NDArray[np.int64]]:
        free = self.beam.free
        return {(0,): free[free % 2 == 0], (1,): free[free % 2 == 1], (0, 1): free}

    def reading(self, positions_m: FloatArray) -> FloatArray:
        """Transverse displacement at points of the vibrating coordinates, shape (k, d)."""
        one = self.beam.interpolation(positions_m)
        out = np.zeros((one.shape[0], 4 * (self.standard.elements + 1)))
        out[:, self.beam.held + 1 :: 2] = one
        return out.take(self.free(self.modal), axis=1)

    @cached_property
    def known_kg(self) -> FloatArray:
        """Inertia of the known point masses in one direction, which no factor changes."""
        p = self.standard
        return self.beam.bodies_kg(p.point_masses[: len(p.point_masses) - self.bodies])

    @cached_property
    def held_per_m(self) -> float:
        """Stiffness of the clamp against translation over EA of the first element, where its own is not given."""
        clamp = self.standard.clamp
        free = clamp is None or clamp.translation_n_m is not None
        return 0.0 if free else ancf.TUNING.held_by / self.beam.element_length_m

    @cached_property
    def body_kg(self) -> FloatArray:
        """Inertia of each unknown point mass in one direction over all nodes, shape (b, 2 (ne + 1), 2 (ne + 1))."""
        size = 2 * (self.standard.elements + 1)
        unknown = self.standard.point_masses[len(self.standard.point_masses) - self.bodies :]
        return np.reshape([self.beam.bodies_kg((point,)) for point in unknown], (-1, size, size))

    def gathered(self, by_element: Array) -> Array:
        """Sum over the elements, the transpose of `AncfBeam.elements`: (..., ne, 2, 4) to (..., 4 (ne + 1))."""
        out = np.zeros((*by_element.shape[:-3], 4 * (self.standard.elements + 1)), dtype=by_element.dtype)
        for e, index in enumerate(self.beam.element_indices):
            out[..., index] += by_element[..., e, :, :]
        return out

    def full(self, free: Array, directions: tuple[int, ...]) -> Array:
        """All coordinates from the free ones of some directions (the last axis), the others zero."""
        out = np.zeros((*free.shape[:-1], 4 * (self.standard.elements + 1)), dtype=free.dtype)
        out[..., self.free(directions)] = free
        return out

    def _assembled(self, blocks: Array, constant: Array, directions: tuple[int, ...]) -> Array:
        """Matrix over the free coordinates from element blocks (n, ne, c, c, 4, 4) and a matrix of one direction."""
        n, ne, c = blocks.shape[0], self.standard.elements, len(directions)
        size = 2 * c * (ne + 1)
        out = np.zeros((n, size, size), dtype=blocks.dtype)
        square = blocks.transpose(0, 1, 4, 2, 5, 3).reshape(n, ne, 4 * c, 4 * c)
        for e in range(ne):
            at = slice(2 * c * e, 2 * c * e + 4 * c)
            out[:, at, at] += square[:, e]
        for d in range(c):
            out[:, d::c, d::c] += constant
        free = self.free(directions) // (3 - c)
        return np.asarray(out.take(free, axis=1).take(free, axis=2))

    def springs(self, axial: Array, grip: Array) -> Array:
        """Stiffness of tension and elastic clamp in one direction, for EA of the elements, shape (n, c, c)."""
        displacement, rotation = self.beam.springs(axial)
        out = np.repeat(self.beam.tensioned_n_m[np.newaxis].astype(axial.dtype), axial.shape[0], axis=0)
        out[:, 0, 0] += displacement * grip[:, 0]
        out[:, 1, 1] += rotation * grip[:, 1]
        return out

    @cached_property
    def _products(self) -> FloatArray:
        """Weighted products of two slopes at each Gauss point, shape (g, 16)."""
        products = np.einsum("g,gk,gl->gkl", self.beam.weight_m, self.gradient, self.gradient)
        return np.asarray(products.reshape(-1, 16))

    def _stiffness(
        self,
        bend: Array,
        axial: Array,
        springs: Array,
        q: Array,
        directions: tuple[int, ...],
        *,
        stretch_alone: bool = False,
    ) -> Array:
        """Tangent of the elastic forces, shape (n, d, d)."""
        strain, turned = self.beam.strained(q)
        chosen = turned[:, :, list(directions)]
        of_point = chosen[:, :, :, np.newaxis] * chosen[:, :, np.newaxis]
        one = np.eye(len(directions))[:, :, np.newaxis]
        if not stretch_alone:
            of_point = of_point + strain[:, :, np.newaxis, np.newaxis] * one
        of_point = of_point * axial[:, :, np.newaxis, np.newaxis, np.newaxis]
        blocks = (of_point @ self._products).reshape(*of_point.shape[:-1], 4, 4)
        if stretch_alone:
            return self._assembled(blocks, np.zeros_like(self.known_kg), directions)
        return self._assembled(
            blocks + _by_element(bend, self.units[0], len(directions)), springs, directions
        )

    def _residual(
        self, bend: Array, axial: Array, springs: Array, mass: Array, points: Array, q: Array
    ) -> Array:
        """Weight minus elastic force over all coordinates, shape (n, 4 (ne + 1))."""
        strain, turned = self.beam.strained(q)
        tension = axial[:, :, np.newaxis] * strain * self.beam.weight_m
        gravity = self.beam.gravity_m_s2
        force = mass[:, :, np.newaxis, np.newaxis] * np.outer(gravity, self.units[2])
        force = force - (turned * tension[:, :, np.newaxis]) @ self.gradient
        force = force - bend[:, :, np.newaxis, np.newaxis] * (self.beam.elements(q) @ self.units[0])
        out = self.gathered(force)
        for d in range(2):
            held = np.einsum("nij,nj->ni", springs, q[:, d::2])
            out[:, d::2] += gravity[d] * np.sum(points[:, :, 0::2], axis=-1) - held
        return out

    @cached_property
    def _start(self) -> FloatArray:
        """Equilibrium of the standard beam, all coordinates, shape (4 (ne + 1),)."""
        return np.pad(static_equilibrium(self.beam), (self.beam.held, 0))

    def _equilibrium(self, bend: Array, axial: Array, springs: Array, mass: Array, points: Array) -> Array:
        """Static equilibria, shape (n, 4 (ne + 1)); NaN where Newton's method does not converge."""
        q = np.repeat(self._start[np.newaxis].astype(bend.dtype), bend.shape[0], axis=0)
        if not np.any(self.beam.gravity_m_s2):
            return q
        free = self.free(self.static)
        scale = self.scale(self.static)
        small = statics.TUNING.settled * self.standard.length_m
        previous = np.full(bend.shape[0], np.inf)
        done = np.zeros(bend.shape[0], dtype=np.bool_)
        for _ in range(statics.TUNING.iterations):
            todo = np.flatnonzero(~done)
            parts = bend[todo], axial[todo], springs[todo]
            tangent = self._stiffness(*parts, q[todo], self.static)
            residual = self._residual(*parts, mass[todo], points[todo], q[todo])[:, free]
            move = scaled_solve(tangent, residual[:, :, np.newaxis], scale)[:, :, 0]
            size = np.max(np.abs(move * scale), axis=1)
            q[todo[:, np.newaxis], free] += move
            done[todo] = (size < small) | ((size < 100.0 * small) & (size > 0.5 * previous[todo]))
            lost = ~(size < statics.TUNING.lost * self.standard.length_m)
            done[todo] |= lost
            q[todo[lost]] = np.nan
            previous[todo] = size
            if np.all(done):
                return q
        q[~done] = np.nan
        return q

    def state(self, u: Array) -> BeamStates:
        """Equilibria and matrices of the beams with the log factors `u`, shape (n, v)."""
        ne, p = self.standard.elements, self.standard
        width, thickness, density, modulus = u[:, :ne], u[:, ne : 2 * ne], u[:, [2 * ne]], u[:, [2 * ne + 1]]
        bend = p.elastic_modulus_pa * p.second_moment_m4 * np.exp(modulus + width + 3.0 * thickness)
        axial = p.elastic_modulus_pa * p.area_m2 * np.exp(modulus + width + thickness)
        mass = p.density_kg_m3 * p.area_m2 * np.exp(density + width + thickness)
        more = np.exp(u[:, 2 * ne + 2 :])
        body, grip = more[:, : self.bodies], more[:, self.bodies :]
        if not self.clamp:
            grip = np.ones((u.shape[0], 2))
        springs = self.springs(axial, grip)
        points = self.known_kg + np.tensordot(body, self.body_kg, 1)
        q = self._equilibrium(bend, axial, springs, mass, points)
        blocks = _by_element(mass, self.units[1], len(self.modal))
        return BeamStates(
            bend,
            axial,
            mass,
            body,
            grip,
            q,
            self._stiffness(bend, axial, springs, q, self.static),
            self._stiffness(bend, axial, springs, q, self.modal),
            self._assembled(blocks, points, self.modal),
            None
            if self.straight
            else self._stiffness(bend, axial, springs, q, self.modal, stretch_alone=True),
        )


def _by_element(values: Array, unit: FloatArray, directions: int) -> Array:
    """Multiples of one matrix for every direction: (n, ne) and (4, 4) to (n, ne, c, c, 4, 4)."""
    one = np.eye(directions)[:, :, np.newaxis, np.newaxis]
    return np.asarray(values[:, :, np.newaxis, np.newaxis, np.newaxis, np.newaxis] * (one * unit))


def scaled_solve(matrix: Array, right: Array, scale: FloatArray) -> Array:
    """Solution of many systems, scaled by `scale` (m per coordinate); (n, d, d) and (n, d, k) to (n, d, k)."""
    solved = np.linalg.solve(matrix / np.outer(scale, scale), right / scale[:, np.newaxis])
    return np.asarray(solved / scale[:, np.newaxis])


def changes(
    matrices: BeamMatrices, state: BeamStates, left: FloatArray, right: FloatArray, square: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """``left^T (dK - square dM) right`` and ``left^T dM right`` for each variable, shape (n, f, v) each.

    With respect to the logarithms of widths, thicknesses, density, modulus, unknown point masses and an unknown clamp;
    for vectors over the vibrating coordinates, (n, f, d), and `square`, (n, f).
    """
    strain, turned = matrices.beam.strained(state.q)
    left, right = (matrices.full(x, matrices.modal) for x in (left, right))
    w, v = matrices.beam.elements(left), matrices.beam.elements(right)
    w_s, v_s = w @ matrices.gradient.T, v @ matrices.gradient.T
    w_t, v_t = (np.sum(x * turned[:, np.newaxis], axis=-2) for x in (w_s, v_s))
    wv = np.sum(w_s * v_s, axis=-2)
    curve, value, _ = matrices.units
    held = matrices.held_per_m
    bend = np.sum((w @ curve) * v, axis=(-2, -1)) * state.bend[:, np.newaxis]
    axial = (w_t * v_t + strain[:, np.newaxis] * wv) @ matrices.beam.weight_m
    axial[:, :, 0] += held * np.sum(w[:, :, 0, :, 0] * v[:, :, 0, :, 0], axis=-1)
    axial *= state.axial[:, np.newaxis]
    kinetic = np.sum((w @ value) * v, axis=(-2, -1)) * state.mass[:, np.newaxis]
    two = (*left.shape[:2], -1, 2)
    body = np.einsum("nfid,bij,nfjd->nfb", left.reshape(two), matrices.body_kg, right.reshape(two))
    body = body * state.body[:, np.newaxis]
    moved = kinetic, body
    stiffness = _grip(matrices, state)[:, np.newaxis]
    grip = np.sum(w[:, :, 0, :, :2] * v[:, :, 0, :, :2], axis=-2)[:, :, : stiffness.shape[2]] * stiffness
    mass, body = (-square[:, :, np.newaxis] * x for x in moved)
    if np.any(matrices.beam.gravity_m_s2):
        # derivative of left^T K right with respect to the state
        along = w_s * v_t[..., np.newaxis, :] + v_s * w_t[..., np.newaxis, :]
        along += turned[:, np.newaxis] * wv[..., np.newaxis, :]
        more = _by_equilibrium(matrices, state, along)
        bend, axial, mass, body, grip = (
            x + y for x, y in zip((bend, axial, mass, body, grip), more, strict=True)
        )
    zero = np.zeros_like(bend)
    return _to_variables(bend, axial, mass, body, grip), _to_variables(zero, zero, *moved, 0.0 * grip)


def _grip(matrices: BeamMatrices, state: BeamStates) -> FloatArray:
    """Stiffness of an unknown clamp against translation and rotation; shape (n, 2), or (n, 0) of a known one."""
    springs = np.stack(np.broadcast_arrays(*matrices.beam.springs(state.axial)), axis=-1) * state.grip
    return springs[:, : 2 * matrices.clamp]


def _by_equilibrium(
    matrices: BeamMatrices, state: BeamStates, along: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Contribution of the change of the equilibrium with log EI, EA and rho A, (n, f, ne) each, masses and clamp.

    `along` is the derivative of a quantity with respect to the slopes at the Gauss points, over EA, shape
    (n, f, ne, 2, g). With the adjoint state a the contribution is ``a^T (F_weight - F_elastic)_p``.
    """
    strain, turned = matrices.beam.strained(state.q)
    q = matrices.beam.elements(state.q)
    weight = matrices.beam.weight_m * state.axial[:, :, np.newaxis]
    adjoint = _adjoint(matrices, state, (along * weight[:, np.newaxis, :, np.newaxis]) @ matrices.gradient)
    a = matrices.beam.elements(adjoint)
    a_t = np.sum((a @ matrices.gradient.T) * turned[:, np.newaxis], axis=-2)
    curve, _, load = matrices.units
    bend = -np.sum(a * (q @ curve)[:, np.newaxis], axis=(-2, -1))
    axial = -np.sum(a_t * (weight * strain)[:, np.newaxis], axis=-1)
    held = matrices.held_per_m * state.axial[:, np.newaxis, 0]
    axial[:, :, 0] -= held * np.sum(a[:, :, 0, :, 0] * q[:, np.newaxis, 0, :, 0], axis=-1)
    mass = np.sum(a * np.outer(matrices.beam.gravity_m_s2, load), axis=(-2, -1))
    fall = adjoint.reshape(*adjoint.shape[:2], -1, 2) @ matrices.beam.gravity_m_s2
    body = fall @ np.sum(matrices.body_kg[:, :, 0::2], axis=-1).T * state.body[:, np.newaxis]
    grip = _grip(matrices, state)[:, np.newaxis]
    grip = -np.sum(a[:, :, 0, :, :2] * q[:, np.newaxis, 0, :, :2], axis=-2)[:, :, : grip.shape[2]] * grip
    return bend * state.bend[:, np.newaxis], axial, mass * state.mass[:, np.newaxis], body, grip


def _adjoint(matrices: BeamMatrices, state: BeamStates, nodal: FloatArray) -> FloatArray:
    """Solution of ``K a = nodal`` at the equilibrium; (n, f, ne, 2, 4) to all coordinates, (n, f, 4 (ne + 1))."""
    full = matrices.gathered(nodal)
    scale = matrices.scale(matrices.static)
    rows = np.swapaxes(full[:, :, matrices.free(matrices.static)], 1, 2)
    lost = ~np.all(np.isfinite(state.static_k), axis=(1, 2))
    tangent = np.where(lost[:, np.newaxis, np.newaxis], np.eye(scale.size), state.static_k)
    solved = scaled_solve(tangent, rows, scale)
    return matrices.full(np.swapaxes(solved, 1, 2), matrices.static)


def _to_variables(
    bend: FloatArray, axial: FloatArray, mass: FloatArray, body: FloatArray, grip: FloatArray
) -> FloatArray:
    """From derivatives by log EI, log EA and log rho A, (..., ne), masses and clamp to those by the variables."""
    total = bend + axial + mass
    of_density = np.sum(mass, axis=-1, keepdims=True)
    of_modulus = np.sum(bend + axial, axis=-1, keepdims=True)
    return np.concatenate([total, total + 2.0 * bend, of_density, of_modulus, body, grip], axis=-1)

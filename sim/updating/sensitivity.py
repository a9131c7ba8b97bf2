"""Derivatives of ``left^T (K - square M) right`` with respect to the factors, with the change of the equilibrium.

See `sim.updating.beam_family` for the equations.
"""

from __future__ import annotations

import numpy as np

from sim.updating.matrices import BeamMatrices, BeamStates, scaled_solve
from tracker import FloatArray


def changes(
    matrices: BeamMatrices, state: BeamStates, left: FloatArray, right: FloatArray, square: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """``left^T (dK - square dM) right`` and ``left^T dM right`` for each variable, shape (n, f, 2 ne + 2) each.

    With respect to the logarithms of widths, thicknesses, density and modulus; for vectors over the vibrating
    coordinates, (n, f, d), and `square`, (n, f).
    """
    strain, turned = matrices.beam.strained(state.q)
    w, v = (matrices.beam.elements(matrices.full(x, matrices.modal)) for x in (left, right))
    w_s, v_s = w @ matrices.gradient.T, v @ matrices.gradient.T
    w_t, v_t = (np.sum(x * turned[:, np.newaxis], axis=-2) for x in (w_s, v_s))
    wv = np.sum(w_s * v_s, axis=-2)
    curve, value, _ = matrices.units
    held = matrices.constant[2][0, 0]
    bend = np.sum((w @ curve) * v, axis=(-2, -1)) * state.bend[:, np.newaxis]
    axial = (w_t * v_t + strain[:, np.newaxis] * wv) @ matrices.beam.weight_m
    axial[:, :, 0] += held * np.sum(w[:, :, 0, :, 0] * v[:, :, 0, :, 0], axis=-1)
    axial *= state.axial[:, np.newaxis]
    kinetic = np.sum((w @ value) * v, axis=(-2, -1)) * state.mass[:, np.newaxis]
    mass = -square[:, :, np.newaxis] * kinetic
    if np.any(matrices.gravity()):
        # derivative of left^T K right with respect to the state
        along = w_s * v_t[..., np.newaxis, :] + v_s * w_t[..., np.newaxis, :]
        along += turned[:, np.newaxis] * wv[..., np.newaxis, :]
        more = _by_equilibrium(matrices, state, along)
        bend, axial, mass = bend + more[0], axial + more[1], mass + more[2]
    zero = np.zeros_like(bend)
    return _to_variables(bend, axial, mass), _to_variables(zero, zero, kinetic)


def _by_equilibrium(
    matrices: BeamMatrices, state: BeamStates, along: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Contribution of the change of the equilibrium with log EI, log EA and log rho A, shape (n, f, ne) each.

    `along` is the derivative of a quantity with respect to the slopes at the Gauss points, over EA, shape
    (n, f, ne, 2, g). With the adjoint state a the contribution is ``a^T (F_weight - F_elastic)_p``.
    """
    strain, turned = matrices.beam.strained(state.q)
    q = matrices.beam.elements(state.q)
    weight = matrices.beam.weight_m * state.axial[:, :, np.newaxis]
    a = matrices.beam.elements(
        _adjoint(matrices, state, (along * weight[:, np.newaxis, :, np.newaxis]) @ matrices.gradient)
    )
    a_t = np.sum((a @ matrices.gradient.T) * turned[:, np.newaxis], axis=-2)
    curve, _, load = matrices.units
    bend = -np.sum(a * (q @ curve)[:, np.newaxis], axis=(-2, -1))
    axial = -np.sum(a_t * (weight * strain)[:, np.newaxis], axis=-1)
    held = matrices.constant[2][0, 0] * state.axial[:, np.newaxis, 0]
    axial[:, :, 0] -= held * np.sum(a[:, :, 0, :, 0] * q[:, np.newaxis, 0, :, 0], axis=-1)
    mass = np.sum(a * np.outer(matrices.gravity(), load), axis=(-2, -1))
    return bend * state.bend[:, np.newaxis], axial, mass * state.mass[:, np.newaxis]


def _adjoint(matrices: BeamMatrices, state: BeamStates, nodal: FloatArray) -> FloatArray:
    """Solution of ``K a = nodal`` at the equilibrium; (n, f, ne, 2, 4) to all coordinates, (n, f, 4 (ne + 1))."""
    full = matrices.gathered(nodal)
    scale = np.repeat(matrices.scale[matrices.held :], len(matrices.static))
    rows = np.swapaxes(full[:, :, matrices.free(matrices.static)], 1, 2)
    lost = ~np.all(np.isfinite(state.static_k), axis=(1, 2))
    tangent = np.where(lost[:, np.newaxis, np.newaxis], np.eye(scale.size), state.static_k)
    solved = scaled_solve(tangent, rows, scale)
    return matrices.full(np.swapaxes(solved, 1, 2), matrices.static)


def _to_variables(bend: FloatArray, axial: FloatArray, mass: FloatArray) -> FloatArray:
    """From derivatives by log EI, log EA and log rho A, (..., ne), to those by the variables, (..., 2 ne + 2)."""
    total = bend + axial + mass
    of_density = np.sum(mass, axis=-1, keepdims=True)
    of_modulus = np.sum(bend + axial, axis=-1, keepdims=True)
    return np.concatenate([total, total + 2.0 * bend, of_density, of_modulus], axis=-1)

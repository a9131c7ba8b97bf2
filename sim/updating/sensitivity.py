"""Derivatives of ``left^T (K - square M) right`` to the factors, the equilibrium's motion included.

See `sim.updating.family` for the equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.updating.matrices import BeamMatrices, BeamStates, scaled_solve

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class _Strained:
    """Axial strain of the equilibria, shape (n, ne, g), and the derivative of their place, (n, ne, g, 2)."""

    strain: FloatArray
    turned: FloatArray
    coordinates: FloatArray


def changes(
    matrices: BeamMatrices, state: BeamStates, left: FloatArray, right: FloatArray, square: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """``left^T (dK - square dM) right`` and ``left^T dM right`` for each variable.

    Parameters
    ----------
    matrices : BeamMatrices
    state : BeamStates
    left, right : array, shape (n, f, d)
        Of the coordinates that vibrate.
    square : array, shape (n, f)

    Returns
    -------
    array, shape (n, f, 2 ne + 2), twice
        To the logarithms of widths, thicknesses, density and modulus.
    """
    now = _strained(matrices, state)
    w, v = (matrices.elements(matrices.full(x, matrices.modal)) for x in (left, right))
    w_s, v_s = (np.einsum("gk,nfekc->nfegc", matrices.gradient, x) for x in (w, v))
    w_t, v_t = (np.einsum("nfegc,negc->nfeg", x, now.turned) for x in (w_s, v_s))
    wv = np.sum(w_s * v_s, axis=-1)
    curve, value, _ = matrices.units
    held = matrices.constant[2][0, 0]
    bend = np.einsum("nfekc,kl,nfelc->nfe", w, curve, v, optimize=True)
    axial = np.einsum("g,nfeg->nfe", matrices.beam.weight_m, w_t * v_t + now.strain[:, np.newaxis] * wv)
    axial[:, :, 0] += held * np.sum(w[:, :, 0, 0] * v[:, :, 0, 0], axis=-1)
    kinetic = np.einsum("nfekc,kl,nfelc->nfe", w, value, v, optimize=True) * state.mass[:, np.newaxis]
    bend, axial = bend * state.bend[:, np.newaxis], axial * state.axial[:, np.newaxis]
    mass = -square[:, :, np.newaxis] * kinetic
    if np.any(matrices.gravity()):
        # derivative of left^T K right to the state
        along = w_s * v_t[..., np.newaxis] + v_s * w_t[..., np.newaxis]
        along = along + now.turned[:, np.newaxis] * wv[..., np.newaxis]
        more = _by_equilibrium(matrices, state, now, along)
        bend, axial, mass = bend + more[0], axial + more[1], mass + more[2]
    zero = np.zeros_like(bend)
    return _to_variables(bend, axial, mass), _to_variables(zero, zero, kinetic)


def rayleigh_quotients(matrices: BeamMatrices, state: BeamStates, phi: FloatArray) -> FloatArray:
    """``phi^T K phi / phi^T M phi`` from curvatures and strains, shape (n, f), of modes with shape (n, f, d).

    Summed over the elements' own strains nothing large cancels, as it does in ``K phi`` of a low mode: a relative
    1e-12 instead of 1e-8.
    """
    now = _strained(matrices, state)
    v = matrices.elements(matrices.full(phi, matrices.modal))
    slope = np.einsum("gk,nfekc->nfegc", matrices.gradient, v)
    curve = np.einsum("gk,nfekc->nfegc", matrices.curvature, v)
    stretch = np.einsum("nfegc,negc->nfeg", slope, now.turned)
    weight, half = matrices.beam.weight_m, 0.5 * matrices.beam.element_length_m
    stretch = stretch**2 + now.strain[:, np.newaxis] * np.sum(slope**2, axis=-1)
    energy = np.einsum("ne,g,nfeg->nf", state.axial, weight, stretch, optimize=True)
    energy += half * np.einsum("ne,nfegc->nf", state.bend, curve**2, optimize=True)
    springs = np.diagonal(matrices.springs(state.axial), axis1=1, axis2=2)[:, np.newaxis, :2, np.newaxis]
    energy += np.sum(springs * v[:, :, 0, :2] ** 2, axis=(2, 3))
    return np.asarray(energy / np.einsum("nfd,nde,nfe->nf", phi, state.modal_m, phi, optimize=True))


def _strained(matrices: BeamMatrices, state: BeamStates) -> _Strained:
    at = matrices.elements(state.q)
    slope = np.einsum("gk,nekc->negc", matrices.gradient, at)
    strain = slope[..., 0] + 0.5 * np.sum(slope * slope, axis=-1)
    return _Strained(strain, slope + np.array([1.0, 0.0]), at)


def _by_equilibrium(
    matrices: BeamMatrices, state: BeamStates, now: _Strained, along: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What the motion of the equilibrium adds, to log EI, log EA and log rho A, shape (n, f, ne) each.

    `along` is the derivative of a quantity to the slopes at the Gauss points over EA, shape (n, f, ne, g, 2). The
    adjoint state a gives it as ``a^T (F_weight - F_elastic)_p``.
    """
    gradient, weight = matrices.gradient, matrices.beam.weight_m
    nodal = np.einsum("gk,g,ne,nfegc->nfekc", gradient, weight, state.axial, along, optimize=True)
    a = matrices.elements(_adjoint(matrices, state, nodal))
    a_t = np.einsum("gk,nfekc,negc->nfeg", gradient, a, now.turned, optimize=True)
    curve, _, load = matrices.units
    bend = -np.einsum("nfekc,kl,nelc->nfe", a, curve, now.coordinates, optimize=True)
    axial = -np.einsum("g,neg,nfeg->nfe", weight, now.strain, a_t, optimize=True)
    held = matrices.constant[2][0, 0]
    axial[:, :, 0] -= held * np.einsum("nfc,nc->nf", a[:, :, 0, 0], now.coordinates[:, 0, 0])
    mass = np.einsum("nfekc,k,c->nfe", a, load, matrices.gravity(), optimize=True)
    return (
        bend * state.bend[:, np.newaxis],
        axial * state.axial[:, np.newaxis],
        mass * state.mass[:, np.newaxis],
    )


def _adjoint(matrices: BeamMatrices, state: BeamStates, nodal: FloatArray) -> FloatArray:
    """Solution of ``K a = nodal`` at the equilibrium; (n, f, ne, 4, 2) to all coordinates, (n, f, 4 (ne + 1))."""
    n, f, ne = nodal.shape[:3]
    full = np.zeros((n, f, 4 * (ne + 1)))
    for e in range(ne):
        full[:, :, 4 * e : 4 * e + 8] += nodal[:, :, e].reshape(n, f, 8)
    scale = np.repeat(matrices.scale[matrices.held :], len(matrices.static))
    rows = np.swapaxes(full[:, :, matrices.free(matrices.static)], 1, 2)
    lost = ~np.all(np.isfinite(state.static_k), axis=(1, 2))
    tangent = np.where(lost[:, np.newaxis, np.newaxis], np.eye(scale.size), state.static_k)
    solved = scaled_solve(tangent, rows, scale)
    return matrices.full(np.swapaxes(solved, 1, 2), matrices.static)


def _to_variables(bend: FloatArray, axial: FloatArray, mass: FloatArray) -> FloatArray:
    """Derivatives to log EI, log EA and log rho A, (..., ne), to those to the variables, (..., 2 ne + 2)."""
    total = bend + axial + mass
    of_density = np.sum(mass, axis=-1, keepdims=True)
    of_modulus = np.sum(bend + axial, axis=-1, keepdims=True)
    return np.concatenate([total, total + 2.0 * bend, of_density, of_modulus], axis=-1)

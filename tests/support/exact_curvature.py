r"""Bending energy with the exact curvature, to check the simplified one: ``kappa = (r' x r'') / |r'|^3``.

.. math::  U_b = \tfrac12 \int EI\,\kappa^2\,dx, \quad
    \nabla\kappa = s^{-3/2}\,\nabla c - 3 c s^{-5/2} p, \quad c = x' y'' - y' x'', \quad s = r' \cdot r', \quad
    p = (x', y', 0, 0)

over z = (x', y', x'', y''); the Hessian is written out in the same way. Gerstmayr and Shabana (2006), Eq. 20, use the
same curvature. It costs many times the simplified form.
"""

from dataclasses import replace

import numpy as np

from sim.beam import AncfBeam, from_band, shape_functions, to_band
from tracker import FloatArray

GAUSS_POINTS = 5


class ExactCurvatureBeam(AncfBeam):
    """A rigidly clamped beam with the exact curvature, for statics and modes."""

    def elastic(self, q):
        state = super().elastic(q)
        simple = self.bending_n_m
        p, h = self.properties, self.element_length_m
        nodes, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
        at = 0.5 * (nodes + 1.0)
        full = np.concatenate([np.zeros(self.held), np.asarray(q, dtype=np.float64)])
        stiffness = np.outer(p.elastic_modulus_pa * p.second_moment_m4, 0.5 * h * weights)
        energy, force, tangent = assembled_bending(
            full, shape_functions(at, h, 1), shape_functions(at, h, 2), stiffness
        )
        held = self.held
        moved = from_band(simple) @ q
        return replace(
            state,
            energy_j=state.energy_j + energy - 0.5 * float(q @ moved),
            force_n=state.force_n + force[held:] - moved,
            tangent=state.tangent + to_band(tangent[held:, held:]) - simple,
        )

    def second_variation(self, q, v, bend=None, axial=None):
        assert bend is None
        assert axial is None
        moved = v[..., self.held :]
        return np.einsum("fi,ij,fj->f", moved, from_band(self.elastic(q[self.held :]).tangent), moved)


def exact_bending(
    nodal: FloatArray, dshape: FloatArray, ddshape: FloatArray, stiffness: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Energy, forces (ne, 8) and tangents (ne, 8, 8) of the exact curvature, over the coordinates of each element.

    Those are (axial, transverse) of position and slope of either node. `nodal`, (ne, 4, 2), holds the displacement
    along and across of (position, slope) of each element's two nodes, `dshape` and `ddshape`, (g, 4), the derivatives
    of the shape functions at the Gauss points, and `stiffness`, (ne, g), EI times the Gauss weight in m.
    """
    z = np.concatenate(
        [np.einsum("gk,ekd->egd", dshape, nodal), np.einsum("gk,ekd->egd", ddshape, nodal)], axis=-1
    )
    z[..., 0] += 1.0
    x, y, xx, yy = np.moveaxis(z, -1, 0)
    c, s = x * yy - y * xx, x * x + y * y
    kappa = c * s**-1.5
    p = np.stack([x, y, np.zeros_like(x), np.zeros_like(x)], axis=-1)
    slope_c = np.stack([yy, -xx, -y, x], axis=-1)
    gradient = slope_c * (s**-1.5)[..., np.newaxis] - p * (3.0 * c * s**-2.5)[..., np.newaxis]
    bend_c = np.zeros((4, 4))
    bend_c[0, 3] = bend_c[3, 0] = 1.0
    bend_c[1, 2] = bend_c[2, 1] = -1.0
    cross = slope_c[..., :, np.newaxis] * p[..., np.newaxis, :]
    cross = cross + np.swapaxes(cross, -1, -2)
    wide = (..., np.newaxis, np.newaxis)
    hessian = (
        (s**-1.5)[wide] * bend_c
        - 3.0 * (s**-2.5)[wide] * cross
        - 3.0 * (c * s**-2.5)[wide] * np.diag([1.0, 1.0, 0.0, 0.0])
        + 15.0 * (c * s**-3.5)[wide] * p[..., :, np.newaxis] * p[..., np.newaxis, :]
    )
    hessian = gradient[..., :, np.newaxis] * gradient[..., np.newaxis, :] + kappa[wide] * hessian
    # z as a linear function of the element's coordinates, shape (g, 4, 8)
    linear = np.zeros((dshape.shape[0], 4, 8))
    for d in range(2):
        linear[:, d, d::2] = dshape
        linear[:, 2 + d, d::2] = ddshape
    return (
        float(0.5 * np.sum(stiffness * kappa**2)),
        np.einsum("eg,egz,gzk->ek", stiffness * kappa, gradient, linear),
        np.einsum("eg,gzk,egzw,gwl->ekl", stiffness, linear, hessian, linear, optimize=True),
    )


def assembled_bending(
    coordinates: FloatArray, dshape: FloatArray, ddshape: FloatArray, stiffness: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """`exact_bending` for a whole beam, over the coordinates (4 (ne + 1),) of all nodes, the clamp's first."""
    nodes = coordinates.reshape(-1, 4)
    nodal = np.concatenate([nodes[:-1], nodes[1:]], axis=1).reshape(-1, 4, 2)
    energy, forces, tangents = exact_bending(nodal, dshape, ddshape, stiffness)
    force, tangent = np.zeros(coordinates.size), np.zeros((coordinates.size,) * 2)
    for e in range(nodal.shape[0]):
        own = slice(4 * e, 4 * e + 8)
        force[own] += forces[e]
        tangent[own, own] += tangents[e]
    return energy, force, tangent

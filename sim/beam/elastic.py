"""Elastic force, tangent and energy of a state of the beam, compiled: element and equations are those of `ancf.py`."""

from __future__ import annotations

import numpy as np
from numba import njit

from sim.beam.banded import BAND, PAD, band_product
from tracker import FloatArray


@njit(cache=True)
def gradient_at(padded: FloatArray, offset: int, dshape: FloatArray) -> tuple[float, float]:
    """Displacement gradient (axial, transverse) at a point of the element whose coordinates begin at `offset`."""
    x = 0.0
    y = 0.0
    for k in range(4):
        x += dshape[k] * padded[offset + 2 * k]
        y += dshape[k] * padded[offset + 2 * k + 1]
    return x, y


@njit(cache=True)
def add_block(
    band: FloatArray, offset: int, dshape: FloatArray, block: tuple[float, float, float, float]
) -> None:
    """Add ``N'_k N'_l block`` (2 x 2: xx, xy, yx, yy) to the rows of the element at padded `offset`."""
    n = band.shape[0]
    xx, xy, yx, yy = block
    for k in range(4):
        row = offset + 2 * k - PAD
        if row < 0 or row >= n:
            continue
        for m in range(4):
            scale = dshape[k] * dshape[m]
            column = 2 * (m - k) + PAD
            if offset + 2 * m - PAD < 0:
                continue
            band[row, column] += scale * xx
            band[row, column + 1] += scale * xy
            band[row + 1, column - 1] += scale * yx
            band[row + 1, column] += scale * yy


@njit(cache=True)
def elastic(
    q: FloatArray,
    dshape: FloatArray,
    weight: FloatArray,
    axial_stiffness: FloatArray,
    bending: FloatArray,
    force: FloatArray,
    tangent: FloatArray,
    axial_tangent: FloatArray,
) -> float:
    """Write elastic force, (n,), tangent and its axial part, (n, 15), of the state `q`; returns the energy in J.

    `weight` holds the Gauss weights times the element's length in m, `axial_stiffness` EA of each element in N,
    `bending` the constant matrix.
    """
    n = q.size
    padded = np.zeros(n + 2 * PAD)
    # Entry by entry, as wherever a kernel copies: for a slice numba also compiles the text of an error, for seconds.
    for i in range(n):
        padded[PAD + i] = q[i]
    band_product(bending, padded, force)
    energy = 0.0
    for i in range(n):
        energy += 0.5 * q[i] * force[i]
        for k in range(BAND):
            tangent[i, k] = bending[i, k]
            axial_tangent[i, k] = 0.0
    for e in range(axial_stiffness.size):
        # the node at a rigid clamp lies in the padding
        offset = PAD + n - 4 * (axial_stiffness.size + 1) + 4 * e
        for g in range(weight.size):
            gx, gy = gradient_at(padded, offset, dshape[g])
            strain = gx + 0.5 * (gx * gx + gy * gy)
            ea = axial_stiffness[e] * weight[g]
            normal = ea * strain
            tx = 1.0 + gx
            energy += 0.5 * normal * strain
            for k in range(4):
                row = offset + 2 * k - PAD
                if row >= 0:
                    force[row] += dshape[g, k] * normal * tx
                    force[row + 1] += dshape[g, k] * normal * gy
            material = (ea * tx * tx, ea * tx * gy, ea * tx * gy, ea * gy * gy)
            add_block(axial_tangent, offset, dshape[g], material)
            total = (material[0] + normal, material[1], material[2], material[3] + normal)
            add_block(tangent, offset, dshape[g], total)
    return energy

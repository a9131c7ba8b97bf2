"""Nodes of a mode shape that is known at many places along a beam."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from modal_id.modes.shapes import in_phase
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Nodes of a shape."""

    #: [1] half the window of the fit about a crossing, over the span of the stations
    half_window: float = 0.08
    #: [1] fewest stations in the window
    least_stations: int = 6
    #: [sd] distance from zero that both sides of a crossing must reach somewhere in the window
    #: statistics: Noise does so in 6e-5 of the stations.
    clear_sd: float = 4.0


TUNING = Tuning()


class Node(NamedTuple):
    """Distance of a node from the clamp along the beam and its standard deviation, in mm."""

    position_mm: float
    sd_mm: float


def find_nodes(position_mm: FloatArray, shape: ComplexArray, sd: FloatArray) -> tuple[Node, ...]:
    """Places at which the in-phase part of a shape crosses zero.

    Parameters
    ----------
    position_mm : array, shape (k,)
        Stations where it, the shape or its sd is NaN are left out.
    shape : complex array, shape (k,)
    sd : array, shape (k,)
        Of the real and of the imaginary part, independent from station to station.

    Returns
    -------
    tuple of Node
        In order of their position; none where the stations are too far apart: fewer than six within 16 % of their
        span. The sd has no share from the scale of the positions.

    Notes
    -----
    A weighted cubic through the stations within 8 % of the span of a crossing; the sd is that of its value there
    over its slope, larger where the shape scatters more about the cubic than its sd states. The fourth derivative of
    the shape of a uniform beam is proportional to the shape, so that it vanishes with it: at a node the cubic has no
    bias of fourth order.
    """
    good = np.isfinite(position_mm) & np.isfinite(shape) & np.isfinite(sd) & (sd > 0.0)
    order = np.flatnonzero(good)[np.argsort(position_mm[good], kind="stable")]
    at, values, error = position_mm[order], shape[order], sd[order]
    if np.unique(at).size < TUNING.least_stations:
        return ()
    real = np.real(in_phase(values, error))
    half = TUNING.half_window * float(np.ptp(at))
    found: list[Node] = []
    for k in np.flatnonzero(np.diff(np.sign(real)) != 0.0):
        crossing = 0.5 * float(at[k] + at[k + 1])
        node = _node(at, real, error, crossing, half)
        if node is not None and all(abs(node.position_mm - other.position_mm) > half for other in found):
            found.append(node)
    return tuple(found)


def _node(at: FloatArray, real: FloatArray, error: FloatArray, crossing: float, half: float) -> Node | None:
    """Root of the cubic nearest to a crossing; None where noise may have caused the crossing."""
    for _ in range(3):
        near = np.abs(at - crossing) <= half
        x, y, weight = (at[near] - crossing) / half, real[near], 1.0 / error[near]
        clear = y * weight
        sides = clear[x < 0.0], clear[x > 0.0]
        if np.unique(x).size < TUNING.least_stations or not all(side.size for side in sides):
            return None
        design = np.stack([np.ones_like(x), x, x**2, x**3], axis=1)
        covariance = np.linalg.inv(design.T @ (weight[:, None] ** 2 * design))
        fitted = covariance @ (design.T @ (weight**2 * y))
        value, slope, bend, _ = fitted
        step = -value / slope if slope else np.inf
        # The crossing of a beam at rest, as at its clamp, is one of noise.
        if (
            np.max(sides[0] * -np.sign(slope)) < TUNING.clear_sd
            or np.max(sides[1] * np.sign(slope)) < TUNING.clear_sd
        ):
            return None
        if abs(step) > 1.0:
            return None
        crossing += half * float(step - bend * step**2 / slope)
    left = weight * (y - design @ fitted)
    # Errors that return with the motion (compression, the pixels) leave more than the noise that the sd state.
    factor = float(np.sqrt(max(1.0, float(left @ left) / max(x.size - 4, 1))))
    return Node(crossing, factor * half * float(np.sqrt(covariance[0, 0])) / abs(float(slope)))

"""Number of Gauss-Legendre points that integrate a blurred image over a pixel or an exposure."""

from __future__ import annotations

from functools import lru_cache
from math import ceil, exp, lgamma, log

import numpy as np

from tracker import FloatArray

# largest error of one integral, as a fraction of the contrast: 0.001 counts of 8 bit
TOLERANCE = 4.0e-6
MAX_ORDER = 64
# Standard deviations; longer panels save few points. The bound for a Gaussian holds for its worst place in a panel, and
# exceeds the error by a factor of 20 in short panels and more in long ones.
_PANEL, _PANEL_TOLERANCE = 10.0, 2.0e-5


def order_for(span_over_sigma: float) -> int:
    """Gauss-Legendre order that averages a Gaussian-blurred edge over a span, given in standard deviations of the blur.

    Raises
    ------
    ValueError
        If more than 64 points would be needed: the blur is too small for the span.

    Notes
    -----
    The remainder of the n-point rule over a span d is ``d^(2n) (n!)^4 / ((2n+1) ((2n)!)^3) |f^(2n)|`` for the
    average. For an edge blurred by a Gaussian, ``f^(2n) = He_(2n-1)(z) phi(z) / sigma^(2n)``, and Cramér's
    inequality bounds ``|He_m phi|`` by ``1.0865 sqrt(m!) / sqrt(2 pi)`` (Abramowitz & Stegun 22.14.17, 25.4.30).
    """
    return _order(span_over_sigma, 0, TOLERANCE)


def panels(low: float, high: float, sigma: float) -> tuple[FloatArray, FloatArray]:
    """Points in (low, high) and their weights, which integrate a Gaussian of standard deviation `sigma` anywhere.

    In panels of at most 10 sigma; the order is chosen as in `order_for`, for the Gaussian, the derivative of the edge.
    """
    count = max(1, ceil((high - low) / (_PANEL * sigma)))
    width = (high - low) / count
    nodes, weights = unit_rule(_order(width / sigma, 1, _PANEL_TOLERANCE))
    middles = low + width * (np.arange(count) + 0.5)
    return (middles[:, None] + width * nodes).ravel(), np.tile(width * weights, count)


def _order(span_over_sigma: float, derivative: int, tolerance: float) -> int:
    """Order for an edge, or for its derivative, the Gaussian, integrated over the span."""
    if span_over_sigma == 0.0:
        return 1
    for n in range(1, MAX_ORDER + 1):
        log_error = (
            (2 * n + derivative) * log(span_over_sigma)
            + 4 * lgamma(n + 1)
            - log(2 * n + 1)
            - 3 * lgamma(2 * n + 1)
            + log(0.4334)
            + 0.5 * lgamma(2 * n + derivative)
        )
        if log_error < log(tolerance):
            return n
    msg = (
        f"a span of {span_over_sigma:.1f} standard deviations of the lens blur needs more than {MAX_ORDER} points "
        f"(error {exp(log_error):.1e}, wanted {tolerance:.1e}): raise lens_blur_px, or shorten the exposure"
    )
    raise ValueError(msg)


def unit_rule(order: int) -> tuple[FloatArray, FloatArray]:
    """Nodes in (-1/2, 1/2) and weights that sum to 1, each of shape (order,)."""
    nodes, weights = _rule(order)
    # kernels with explicit signatures need writable arrays, and the cached ones must not change
    return nodes.copy(), weights.copy()


@lru_cache(maxsize=MAX_ORDER)
def _rule(order: int) -> tuple[FloatArray, FloatArray]:
    nodes, weights = np.polynomial.legendre.leggauss(order)
    return 0.5 * nodes, 0.5 * weights

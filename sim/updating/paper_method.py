"""The paper's updating method: 42 variables within 10 %, no gravity, least squares from the standard beam."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim.beam import BeamProperties
from sim.updating.least_squares import Misfit, fit_within, smallest_bound
from sim.updating.measured_modes import MeasuredModes
from tracker import FloatArray, IntArray

_AT_BOUND = 1e-6
# further starting points, which show how far the solution depends on the start
_OTHER_STARTS = 4


@dataclass(frozen=True)
class PaperUpdate:
    """Beam without gravity that fits the measured frequencies and shapes by least squares within a bound.

    Attributes
    ----------
    properties : BeamProperties
        Without gravity (``orientation = "none"``).
    standard_hz, updated_hz : array, shape (m,)
        Without gravity, before and after.
    width_factor, thickness_factor : array, shape (ne,)
    at_bound : tuple of str
        Names of the variables at their bound.
    smallest_bound : float
        Bound below which the frequencies cannot be reached; NaN if none is found.
    start_spread : array, shape (v,)
        Standard deviation of each factor (widths, thicknesses, density, modulus) over solutions from random starts
        within the bound, which fit equally well.
    shape_rms : float
        Deviation of the measured shapes in standard deviations; NaN without shapes.
    """

    properties: BeamProperties
    mode_numbers: IntArray
    standard_hz: FloatArray
    updated_hz: FloatArray
    width_factor: FloatArray
    thickness_factor: FloatArray
    density_factor: float
    elastic_modulus_factor: float
    bound: float
    at_bound: tuple[str, ...]
    smallest_bound: float
    start_spread: FloatArray
    shape_rms: float = float("nan")


def update_like_paper(
    properties: BeamProperties, measured: MeasuredModes, *, bound: float = 0.10, seed: int = 0
) -> PaperUpdate:
    """Fit widths, thicknesses, density and modulus within `bound` to the measured modes, without gravity.

    Minimises the sum of squared deviations of frequencies and shapes over their standard deviations. The problem has
    infinitely many solutions; the one nearest to the standard beam is returned. Point masses are kept; `seed` is that
    of the random starts.

    Raises
    ------
    ValueError
        If the bound is not between 0 and 0.5.
    """
    check_bound(bound)
    standard = replace(properties, orientation="none", angle_deg=None)
    misfit = Misfit.of(standard, measured)
    ne, one = standard.elements, np.ones(misfit.family.variables)
    p = fit_within(misfit, one, bound)
    rng = np.random.default_rng(seed)
    starts = rng.uniform(1.0 - bound, 1.0 + bound, (_OTHER_STARTS, one.size))
    others = np.array([fit_within(misfit, start, bound) for start in starts])
    return PaperUpdate(
        properties=misfit.family.properties(np.log(p)),
        mode_numbers=measured.mode_numbers,
        standard_hz=misfit.frequency_hz(one),
        updated_hz=misfit.frequency_hz(p),
        width_factor=p[:ne].copy(),
        thickness_factor=p[ne : 2 * ne].copy(),
        density_factor=float(p[-2]),
        elastic_modulus_factor=float(p[-1]),
        bound=bound,
        at_bound=_names_at_bound(p, bound),
        smallest_bound=smallest_bound(misfit)[0],
        start_spread=np.std(others, axis=0, ddof=1),
        shape_rms=misfit.shape_rms(p),
    )


def check_bound(bound: float) -> None:
    """Raise ValueError for a bound that is not between 0 and 0.5."""
    if not 0.0 < bound <= 0.5:
        msg = f"bound must lie between 0 and 0.5, got {bound}"
        raise ValueError(msg)


def variable_names(elements: int) -> tuple[str, ...]:
    """Names of the variables in order: widths and thicknesses from the clamp on, density, modulus."""
    fields = [f"{name} of element {e + 1}" for name in ("width", "thickness") for e in range(elements)]
    return (*fields, "density", "elastic modulus")


def _names_at_bound(p: FloatArray, bound: float) -> tuple[str, ...]:
    at = np.abs(np.abs(p - 1.0) - bound) < _AT_BOUND
    names = variable_names((p.size - 2) // 2)
    return tuple(f"{names[i]} ({100 * (p[i] - 1.0):+.0f} %)" for i in np.flatnonzero(at))

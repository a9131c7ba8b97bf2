"""Uniform change of the properties along the beam, and the combinations of properties that the data determine."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim.beam import BeamProperties
from sim.updating.least_squares import Misfit, fit_within
from sim.updating.measured_modes import MeasuredModes
from sim.updating.paper_method import check_bound
from tracker import FloatArray

# a combination is determined if its standard deviation is below this share of the bound
_KNOWN_SHARE = 0.5
# a uniform beam misfits by some per cent, so all modes have equal weight whatever their measured precision
_DISCREPANCY = 0.03


@dataclass(frozen=True)
class UniformUpdate:
    """Uniform change of the properties with the least misfit, with gravity and equal weight of all modes.

    Frequencies and shapes of a uniform beam without point masses depend on E h^2 / rho only (and on length and
    gravity): they do not determine the width, nor E, h and rho separately.

    Attributes
    ----------
    properties : BeamProperties
        With a changed thickness only.
    standard_hz, updated_hz : array, shape (m,)
    thickness_factor, stiffness_factor : float
        Factor on the thickness; its square, the factor on E h^2 / rho.
    combinations : array, shape (4, 4)
        Orthonormal rows: exponents of width, thickness, density and modulus in the combinations that the data
        distinguish, the best determined first.
    combination_sd : array, shape (4,)
        Standard deviation of the logarithm of each; infinite where undetermined.
    known : int
        Number of combinations with a standard deviation below half the bound.
    largest_error : float
        Largest remaining relative deviation of a frequency.
    shape_rms : float
        Deviation of the measured shapes in standard deviations; NaN without shapes.
    """

    properties: BeamProperties
    standard_hz: FloatArray
    updated_hz: FloatArray
    thickness_factor: float
    stiffness_factor: float
    combinations: FloatArray
    combination_sd: FloatArray
    known: int
    largest_error: float
    shape_rms: float


def update_uniform(
    properties: BeamProperties, measured: MeasuredModes, *, bound: float = 0.10
) -> UniformUpdate:
    """Best uniform change of the beam under gravity, of at most `bound`, and the combinations that the data determine.

    Raises
    ------
    ValueError
        If the bound is not between 0 and 0.5.
    BuckledBeamError
        If a standing beam cannot carry its own weight.
    """
    check_bound(bound)
    misfit = Misfit.of(properties, measured)
    spread = uniform_basis(properties.elements)
    one = np.ones(misfit.family.variables)
    with_discrepancy = Misfit.of(properties, replace(measured, model_sd=max(_DISCREPANCY, measured.model_sd)))
    p = fit_within(with_discrepancy, one, bound, spread[:, [1]])
    _, slopes = misfit.at(np.log(p), slopes=True)
    rows = slopes[0] @ spread
    _, values, combinations = np.linalg.svd(rows, full_matrices=True)
    singular = np.zeros(4)
    singular[: values.size] = np.where(values > 1e-9 * values[0], values, 0.0)
    with np.errstate(divide="ignore"):
        sd = 1.0 / singular
    signs = np.sign(combinations[np.arange(4), np.argmax(np.abs(combinations), axis=1)])
    factor = float(p[properties.elements])
    updated_hz = misfit.frequency_hz(p)
    return UniformUpdate(
        properties=misfit.family.properties(np.log(p)),
        standard_hz=misfit.frequency_hz(one),
        updated_hz=updated_hz,
        thickness_factor=factor,
        stiffness_factor=factor**2,
        combinations=combinations * signs[:, np.newaxis],
        combination_sd=sd,
        known=int(np.count_nonzero(sd < _KNOWN_SHARE * bound)),
        largest_error=float(np.max(np.abs(updated_hz / measured.frequency_hz - 1.0))),
        shape_rms=misfit.shape_rms(p),
    )


def uniform_basis(elements: int) -> FloatArray:
    """Matrix from (width, thickness, density, modulus) to all variables, shape (2 ne + 2, 4)."""
    out = np.zeros((2 * elements + 2, 4))
    out[:elements, 0] = out[elements : 2 * elements, 1] = 1.0
    out[-2, 2] = out[-1, 3] = 1.0
    return out

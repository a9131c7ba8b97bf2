r"""Matching the beam's properties to measured natural frequencies (Tables 1 and 3).

The variables are the paper's: width and thickness of each element, density and elastic modulus, each within a
bound of its standard value. They are many more than the measured frequencies, so the data alone decide next to
nothing about single elements: of all fields that explain the frequencies, the prior picks one. It is Gaussian
in the relative changes, with half the bound as standard deviation and, along the beam, the correlation
exp(-(ds / l)^2 / 2) with l a
tenth of the length: smooth and small changes are preferred. What is minimised is

.. math::  \sum_r \Big(\frac{f_r(p) / \hat f_r - 1}{\sigma_r}\Big)^2 + (p - 1)^T C^{-1} (p - 1).

Gravity acts as the orientation says: it lifts the first mode of the paper's hanging beam by 13 %.

References
----------
Yoo, Lee, Kim, "Tracking for high-order damping of thin beam oscillation", Tables 1 and 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, minimize_scalar

from sim.ancf import AncfBeam, from_band
from sim.beam import BeamProperties
from sim.modes import BeamModes, beam_modes
from sim.statics import static_equilibrium
from sim.updating.measured import MODEL_SD, MeasuredShape

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_CORRELATION_LENGTH = 0.1
_DIFFERENCE = 1e-3
# relative to the prior's variance; keeps the smooth covariance invertible
_NUGGET = 1e-4
# modes above the highest needed that a change of shape is made of
_MORE_MODES = 15
_MAX_ITERATIONS = 30
_SMALLEST_SHARE = 1e-3
_MOVE_TOLERANCE = 1e-6


@dataclass(frozen=True)
class UpdatedBeam:
    """A beam whose frequencies are matched to measured ones: one of many that would do.

    Attributes
    ----------
    properties : BeamProperties
    mode_numbers : int array, shape (m,)
    measured_hz, measured_sd_hz, standard_hz, updated_hz : array, shape (m,)
        ``standard_hz`` are those of the properties given.
    uniform_hz : array, shape (m,)
        What one factor on the thickness alone, the same everywhere and within the bound, comes to at its best.
    uniform_thickness_factor : float
    width_factor, thickness_factor : array, shape (ne,)
    density_factor, elastic_modulus_factor : float
    bound : float
    at_bound : int
        Variables that stand at their bound.
    notes : tuple of str
        Sentences for the report.
    """

    properties: BeamProperties
    mode_numbers: IntArray
    measured_hz: FloatArray
    measured_sd_hz: FloatArray
    standard_hz: FloatArray
    updated_hz: FloatArray
    uniform_hz: FloatArray
    uniform_thickness_factor: float
    width_factor: FloatArray
    thickness_factor: FloatArray
    density_factor: float
    elastic_modulus_factor: float
    bound: float
    at_bound: int
    notes: tuple[str, ...]


def update_properties(
    properties: BeamProperties,
    measured_frequency_hz: FloatArray,
    sd_hz: FloatArray,
    mode_numbers: IntArray,
    bound: float = 0.10,
    shapes: tuple[MeasuredShape, ...] = (),
) -> UpdatedBeam:
    """Change the beam's properties within `bound` so that its frequencies are the measured ones.

    Parameters
    ----------
    properties : BeamProperties
        The standard ones; point masses stay as they are.
    measured_frequency_hz, sd_hz : array, shape (m,)
        With their standard deviations; those that are NaN count as zero beside the model's own 1e-4.
    mode_numbers : int array, shape (m,)
        1 first, each once.
    bound : float
        Largest relative change of any variable.
    shapes : tuple of MeasuredShape
        Measured shapes to be matched as well; with frequencies alone the updated shapes may be further from the
        measured ones than the standard beam's.

    Raises
    ------
    ValueError
        If the measured values do not fit each other, or the bound is not between 0 and 0.5.
    BuckledBeamError
        If a standing beam cannot carry its own weight.
    """
    measured = np.asarray(measured_frequency_hz, dtype=np.float64)
    sd = np.nan_to_num(np.asarray(sd_hz, dtype=np.float64))
    numbers = np.asarray(mode_numbers, dtype=np.int64)
    _check(measured, sd, numbers, bound)
    relative_sd = np.hypot(sd / measured, MODEL_SD)
    problem = _Problem(properties, measured, numbers, shapes)
    whiten = np.linalg.inv(np.linalg.cholesky(_prior_covariance(properties.elements, 0.5 * bound)))

    start = np.ones(2 * properties.elements + 2)
    p = _minimise(problem, relative_sd, whiten, start, bound)
    ne = properties.elements
    factor, uniform_hz = _best_uniform(problem, bound)
    updated_hz = problem.frequency_hz(p)
    at_bound = int(np.count_nonzero(np.abs(p - 1.0) > 0.999 * bound))
    return UpdatedBeam(
        properties=problem.beam(p),
        mode_numbers=numbers,
        measured_hz=measured,
        measured_sd_hz=sd,
        standard_hz=problem.frequency_hz(start),
        updated_hz=updated_hz,
        uniform_hz=uniform_hz,
        uniform_thickness_factor=factor,
        width_factor=p[:ne].copy(),
        thickness_factor=p[ne : 2 * ne].copy(),
        density_factor=float(p[-2]),
        elastic_modulus_factor=float(p[-1]),
        bound=bound,
        at_bound=at_bound,
        notes=_notes(properties, updated_hz / measured - 1.0, uniform_hz / measured - 1.0, factor, at_bound),
    )


def _minimise(
    problem: _Problem, relative_sd: FloatArray, whiten: FloatArray, start: FloatArray, bound: float
) -> FloatArray:
    """Gauss-Newton within the bounds.

    Each linearised problem is solved with its bounds exactly; a step that does not help is halved.
    """

    def residual(p: FloatArray) -> FloatArray:
        return np.concatenate([problem.misfit(p, relative_sd), whiten @ (p - 1.0)])

    p, now = start, residual(start)
    for _ in range(_MAX_ITERATIONS):
        slopes = np.vstack([problem.misfit_slopes(p, relative_sd), whiten])
        room = (1.0 - bound - p, 1.0 + bound - p)
        move = np.asarray(lsq_linear(slopes, -now, bounds=(room[0] - 1e-12, room[1] + 1e-12)).x)
        share = 1.0
        while share > _SMALLEST_SHARE:
            trial = np.clip(p + share * move, 1.0 - bound, 1.0 + bound)
            then = residual(trial)
            if then @ then < now @ now:
                break
            share *= 0.5
        else:
            return p
        p, now = trial, then
        if np.max(np.abs(share * move)) < _MOVE_TOLERANCE:
            break
    return p


@dataclass(frozen=True)
class _Problem:
    """Frequencies and shapes as functions of the factors p = (widths, thicknesses, density, modulus)."""

    standard: BeamProperties
    measured: FloatArray
    numbers: IntArray
    shapes: tuple[MeasuredShape, ...] = ()

    def beam(self, p: FloatArray) -> BeamProperties:
        ne = self.standard.elements
        return self.standard.scaled(
            width=p[:ne], thickness=p[ne : 2 * ne], density=float(p[-2]), elastic_modulus=float(p[-1])
        )

    def modes(self, p: FloatArray, more: int = 0) -> BeamModes:
        highest = max(int(self.numbers.max()), *(shape.mode_number for shape in self.shapes), 1)
        count = max(highest, min(highest + more, self.standard.elements))
        return beam_modes(AncfBeam(self.beam(p)), count)

    def frequency_hz(self, p: FloatArray) -> FloatArray:
        return self.modes(p).frequency_hz[self.numbers - 1]

    def misfit(self, p: FloatArray, relative_sd: FloatArray) -> FloatArray:
        """Deviations of frequencies, and of shapes where they are given, over their standard deviations."""
        modes = self.modes(p)
        parts = [(modes.frequency_hz[self.numbers - 1] / self.measured - 1.0) / relative_sd]
        for shape in self.shapes:
            model = modes.transverse_at(shape.positions_m)[:, shape.mode_number - 1]
            parts.append(shape.misfit(model))
        return np.concatenate(parts)

    def misfit_slopes(self, p: FloatArray, relative_sd: FloatArray) -> FloatArray:
        """Derivative of `misfit`, shape (misfits, variables)."""
        modes = self.modes(p, _MORE_MODES)
        change = self.modal_changes(p, modes)
        square = modes.omega_rad_s**2
        own = np.einsum("jrr->rj", change)
        relative = 0.5 * own / square[:, np.newaxis] * modes.frequency_hz[:, np.newaxis]
        rows = [relative[self.numbers - 1] / (self.measured * relative_sd)[:, np.newaxis]]
        for shape in self.shapes:
            r = shape.mode_number - 1
            apart = square[r] - square
            apart[r] = np.inf
            values = modes.transverse_at(shape.positions_m)
            rows.append(shape.misfit_slopes(values[:, r], values @ (change[:, :, r] / apart).T))
        return np.vstack(rows)

    def modal_changes(self, p: FloatArray, modes: BeamModes) -> FloatArray:
        """``phi_s^T (dK - omega_r^2 dM) phi_r`` for each variable, shape (variables, modes, modes), [j, s, r].

        Its diagonal is the derivative of omega_r^2; off it, over the distance of the eigenvalues, stand the modes that
        mode r's shape takes on (Fox and Kapoor). K changes with the equilibrium, which is solved anew.
        """
        phi, square = modes.phi, modes.omega_rad_s**2
        out = np.empty((p.size, modes.count, modes.count))
        for j in range(p.size):
            ends = []
            for sign in (-1.0, 1.0):
                moved = p.copy()
                moved[j] += sign * _DIFFERENCE
                beam = AncfBeam(self.beam(moved))
                equilibrium = static_equilibrium(beam, start=modes.equilibrium)
                stiffness = phi.T @ from_band(beam.elastic(equilibrium).tangent) @ phi
                ends.append(stiffness - phi.T @ beam.mass_matrix() @ phi * square)
            out[j] = (ends[1] - ends[0]) / (2.0 * _DIFFERENCE)
        return out


def _prior_covariance(elements: int, sd: float) -> FloatArray:
    """Of the factors: smooth fields of width and of thickness, independent density and modulus."""
    s = (np.arange(elements) + 0.5) / elements
    smooth = np.exp(-0.5 * ((s[:, np.newaxis] - s) / _CORRELATION_LENGTH) ** 2)
    field = (smooth + _NUGGET * np.eye(elements)) / (1.0 + _NUGGET)
    covariance = np.eye(2 * elements + 2)
    covariance[:elements, :elements] = field
    covariance[elements : 2 * elements, elements : 2 * elements] = field
    return sd**2 * covariance


def _best_uniform(problem: _Problem, bound: float) -> tuple[float, FloatArray]:
    """Best single factor on the thickness, and the frequencies that it gives."""
    ne = problem.standard.elements

    def scaled(factor: float) -> FloatArray:
        p = np.ones(2 * ne + 2)
        p[ne : 2 * ne] = factor
        return problem.frequency_hz(p)

    def misfit(factor: float) -> float:
        return float(np.sum((scaled(factor) / problem.measured - 1.0) ** 2))

    found = minimize_scalar(misfit, bounds=(1.0 - bound, 1.0 + bound), method="bounded")
    return float(found.x), scaled(float(found.x))


def _check(measured: FloatArray, sd: FloatArray, numbers: IntArray, bound: float) -> None:
    if measured.ndim != 1 or measured.size == 0 or not measured.shape == sd.shape == numbers.shape:
        msg = (
            "measured_frequency_hz, sd_hz and mode_numbers need one value a mode each, "
            f"got shapes {measured.shape}, {sd.shape} and {numbers.shape}"
        )
        raise ValueError(msg)
    if not np.all(np.isfinite(measured) & (measured > 0.0)) or np.any(sd < 0.0):
        msg = f"measured frequencies must be finite and positive, got {measured.tolist()} Hz"
        raise ValueError(msg)
    if np.any(numbers < 1) or np.unique(numbers).size != numbers.size:
        msg = f"mode_numbers must be 1 or more, each once; got {numbers.tolist()}"
        raise ValueError(msg)
    if not 0.0 < bound <= 0.5:
        msg = f"bound must lie between 0 and 0.5, got {bound}"
        raise ValueError(msg)


def _notes(
    properties: BeamProperties, error: FloatArray, uniform_error: FloatArray, factor: float, at_bound: int
) -> tuple[str, ...]:
    variables = 2 * properties.elements + 2
    notes = [
        (
            f"{variables} properties are adjusted to {error.size} frequencies: the problem is under-determined. "
            "The field shown is the smoothest and smallest change that explains them, not a measurement of "
            "single elements."
        ),
        f"The updated beam's frequencies differ from the measured ones by at most {100 * np.abs(error).max():.2g} %.",
        (
            f"One factor on the thickness alone ({factor:.3f}) would leave {100 * uniform_error.min():+.2f} to "
            f"{100 * uniform_error.max():+.2f} %."
        ),
    ]
    if at_bound:
        notes.append(f"{at_bound} of the properties stand at their bound.")
    return tuple(notes)

"""How much the poles of a fit differ between parts of its record."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from modal_id.data import MIN_SAMPLES
from modal_id.fit.modal_fit import ModalFit
from modal_id.solve import Problem, fit_poles, frequency_hz, own_problem
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Parts of a record."""

    #: [1] number of parts between which poles may differ
    parts: int = 3
    #: [cycles] shortest part
    least_cycles: float = 2.0


TUNING = Tuning()


def with_spread(model: ModalFit) -> ModalFit:
    """The fit with the largest differences between its poles and those of thirds of the decay as further errors.

    The parts hold equal energy of each mode. A mode whose parts cannot be fitted may have any decay rate up to twice
    the fitted one, and a frequency as uncertain.
    """
    spread = np.concatenate([_largest_difference(model, index) for index in range(model.fit.poles.size)])
    return model.with_repeating(np.diag(spread**2))


def mean_scatter_rad_s(model: ModalFit, index: int) -> float:
    """Standard deviation of a line's angular frequency from its scatter between thirds of the record; 0 if unknown."""
    apart = np.imag(_differences(model, index))
    return float(np.sqrt(np.mean(apart**2) / apart.size)) if apart.size else 0.0


def _largest_difference(model: ModalFit, index: int) -> FloatArray:
    """Of (Re, Im) of the pole with this index."""
    found = _differences(model, index)
    if found.size < 2:
        return np.full(2, abs(complex(model.fit.poles[index]).real))
    return np.array([np.max(np.abs(found.real)), np.max(np.abs(found.imag))])


def _differences(model: ModalFit, index: int) -> ComplexArray:
    """Poles of the parts less that of the fit, as far as the parts can be fitted."""
    pole = complex(model.fit.poles[index])
    data = own_problem(model.problem, model.fit, np.array([index])).data
    energy = np.cumsum(
        np.exp(2.0 * np.minimum(pole.real, 0.0) * data.time_s) * np.any(data.weights > 0.0, axis=1)
    )
    edges = np.searchsorted(energy, np.linspace(0.0, energy[-1], TUNING.parts + 1))
    edges[-1] = data.time_s.size
    least = max(MIN_SAMPLES, int(TUNING.least_cycles / (float(frequency_hz(pole)) * data.step_s)))
    found = []
    for first, last in pairwise(edges):
        if last - first < least:
            continue
        part = data.rows(slice(int(first), int(last)))
        part = part.from_time(float(part.time_s[0]))
        fit = fit_poles(Problem(part, np.ones((part.time_s.size, 1))), np.array([pole]))
        if fit.converged:
            found.append(complex(fit.poles[0]) - pole)
    return np.array(found, dtype=complex)

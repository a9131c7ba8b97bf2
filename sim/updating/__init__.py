"""Updating of the beam's properties from measured modes (Tables 1 and 3), by three methods.

`update_like_paper`: without gravity, every width and thickness, density and modulus free within a bound.
`update_uniform`: with gravity, one change along the whole beam. `update_bayesian`: with gravity, smooth fields and a
sampled posterior. `compare_models` selects between kinds of beam; `update` does all of them.
"""

from sim.updating.bayesian import BayesianUpdate, UndecidedError, update_bayesian
from sim.updating.evidence import ModelComparison, ModelEvidence, compare_models
from sim.updating.least_squares import Misfit, smallest_bound
from sim.updating.measured_modes import MeasuredModes, MeasuredShape
from sim.updating.paper_method import PaperUpdate, update_like_paper, variable_names
from sim.updating.prior import SmoothPrior
from sim.updating.uniform_beam import UniformUpdate, update_uniform
from sim.updating.update import (
    METHODS,
    MOST_ELEMENTS,
    FailedUpdating,
    Method,
    UpdatePart,
    Updating,
    UpdatingSettings,
    all_updates,
    update,
    update_by,
)

__all__ = [
    "METHODS",
    "MOST_ELEMENTS",
    "BayesianUpdate",
    "FailedUpdating",
    "MeasuredModes",
    "MeasuredShape",
    "Method",
    "Misfit",
    "ModelComparison",
    "ModelEvidence",
    "PaperUpdate",
    "SmoothPrior",
    "UndecidedError",
    "UniformUpdate",
    "UpdatePart",
    "Updating",
    "UpdatingSettings",
    "all_updates",
    "compare_models",
    "smallest_bound",
    "update",
    "update_bayesian",
    "update_by",
    "update_like_paper",
    "update_uniform",
    "variable_names",
]

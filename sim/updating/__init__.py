"""Matching the beam's properties to measured modes (Tables 1 and 3), in three ways that stand side by side."""

from sim.updating.measured import MeasuredModes, MeasuredShape
from sim.updating.paper_update import PaperUpdate, update_like_paper
from sim.updating.smoothest import UpdatedBeam, update_properties
from sim.updating.uniform import UniformUpdate, update_uniform

__all__ = [
    "MeasuredModes",
    "MeasuredShape",
    "PaperUpdate",
    "UniformUpdate",
    "UpdatedBeam",
    "update_like_paper",
    "update_properties",
    "update_uniform",
]

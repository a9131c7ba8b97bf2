"""Comparison of recorded decays with simulations under each damping model (Fig. 2 to 4)."""

from sim.comparison.bands import BAND_DRAWS, Candidate, draw_indices
from sim.comparison.compare import FitDecay, compare_decay, obstacle
from sim.comparison.drag import AirDrag, DragFit, DragLimit
from sim.comparison.results import DecayComparison, FailedComparison, ModelDecay
from sim.comparison.scores import ScoreSum

__all__ = [
    "BAND_DRAWS",
    "AirDrag",
    "Candidate",
    "DecayComparison",
    "DragFit",
    "DragLimit",
    "FailedComparison",
    "FitDecay",
    "ModelDecay",
    "ScoreSum",
    "compare_decay",
    "draw_indices",
    "obstacle",
]

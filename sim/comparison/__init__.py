"""Recorded decays against the same decays simulated with each damping model (Fig. 2 to 4)."""

from sim.comparison.candidates import Candidate
from sim.comparison.compare import AIR_DRAG, DEFAULT_STEP_S, Identify, compare_decay
from sim.comparison.posterior import BAND_DRAWS, draw_indices
from sim.comparison.results import DecayComparison, FailedComparison, ModelDecay
from sim.drag import DragFit, DragLimit
from sim.scores import ScoreSum

__all__ = [
    "AIR_DRAG",
    "BAND_DRAWS",
    "DEFAULT_STEP_S",
    "Candidate",
    "DecayComparison",
    "DragFit",
    "DragLimit",
    "FailedComparison",
    "Identify",
    "ModelDecay",
    "ScoreSum",
    "compare_decay",
    "draw_indices",
]

"""Exudyn: a damping matrix of the measured modes, for an object on the nodes of the beam."""

from __future__ import annotations

from collections.abc import Iterator

from modalcam.apps.deck.code import Code, real
from modalcam.apps.deck.damping import Damping
from sim.damping import RayleighDamping

_MATRIX = """\
def modal_damping_matrix(mass, stiffness, free):
    matrix, free = np.zeros(mass.shape), np.ix_(free, free)
    omega_squared, shapes = eigh(stiffness[free], mass[free], subset_by_index=[0, len(ZETA) - 1])
    moved = mass[free] @ shapes
    matrix[free] = moved * (2.0 * ZETA * np.sqrt(omega_squared)) @ moved.T
    return matrix"""


def _modal(damping: Damping) -> Iterator[str]:
    yield from ("import numpy as np", "from scipy.linalg import eigh")
    yield f"ZETA = np.array([{', '.join(map(real, damping.ratios()))}])"
    yield from _MATRIX.split("\n")


def _rayleigh(found: RayleighDamping) -> Iterator[str]:
    yield f"ALPHA_1_S, BETA_S = {real(found.alpha_1_s)}, {real(found.beta_s)}"


_NOTES = (
    "Python. mass, stiffness, _ = mbs.ComputeLinearizedSystem(...) at the equilibrium, for the nodes of the beam.",
    "free: indices of the coordinates that no constraint fixes. Then, in a new model,",
    "AddObject(ObjectGenericODE2(nodeNumbers=nodes, dampingMatrix=modal_damping_matrix(mass, stiffness, free))).",
    "The ratios belong to mode numbers of this model; further modes are undamped.",
    "Rayleigh: Cable2D(physicsBendingDamping=BETA_S*EI, physicsAxialDamping=BETA_S*EA), in N m2 s and N s,",
    "and dampingMatrix=ALPHA_1_S*mass of an ObjectGenericODE2.",
)
EXUDYN = Code("exudyn", "Exudyn", "#", _NOTES, _modal, _rayleigh)

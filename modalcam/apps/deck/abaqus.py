"""Abaqus and CalculiX, whose keywords are alike: ratios by frequency or by mode, Rayleigh damping of a material."""

from __future__ import annotations

from collections.abc import Iterator

from modalcam.apps.deck.code import Code, real
from modalcam.apps.deck.damping import Damping
from sim.damping import RayleighDamping


def _by_frequency(damping: Damping) -> Iterator[str]:
    yield "*MODAL DAMPING, VISCOUS=FRACTION OF CRITICAL DAMPING, DEFINITION=FREQUENCY RANGE"
    yield from (f"{real(frequency)}, {real(ratio)}" for frequency, ratio in damping.table())


def _by_number(damping: Damping) -> Iterator[str]:
    yield "*MODAL DAMPING"
    yield from (f"{n}, {n}, {real(ratio)}" for n, ratio in enumerate(damping.ratios(), 1))


def _material(found: RayleighDamping) -> Iterator[str]:
    yield f"*DAMPING, ALPHA={real(found.alpha_1_s)}, BETA={real(found.beta_s)}"


_ABAQUS = (
    "The modal lines belong in the step of a mode-based procedure: frequencies in Hz, fractions of critical damping.",
    "Ratios are linear between frequencies and constant outside; *SELECT EIGENMODES needs the same DEFINITION.",
    "*DAMPING belongs in *MATERIAL; mode-based steps without SIM ignore it. STRUCTURAL would be 2 zeta.",
)
_CALCULIX = (
    "The modal lines belong in *MODAL DYNAMIC or *STEADY STATE DYNAMICS: first and last mode, fraction of critical.",
    "Modes above the last line are undamped. *DAMPING, STRUCTURAL would be 2 zeta.",
    "*DAMPING belongs in *MATERIAL, once in a deck, for direct *DYNAMIC. By modes, alpha and beta are",
    "*MODAL DAMPING,RAYLEIGH and in the next line ,,alpha,beta.",
)
ABAQUS = Code("abaqus", "Abaqus", "**", _ABAQUS, _by_frequency, _material)
CALCULIX = Code("calculix", "CalculiX", "**", _CALCULIX, _by_number, _material)

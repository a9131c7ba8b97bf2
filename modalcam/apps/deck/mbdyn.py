"""MBDyn: ratios within a modal joint."""

from __future__ import annotations

from collections.abc import Iterator

from modalcam.apps.deck.code import Code, real
from modalcam.apps.deck.damping import Damping
from sim.damping import RayleighDamping


def _modal(damping: Damping) -> Iterator[str]:
    ratios = damping.ratios()
    pairs = (f"{n}, {real(ratio)}" for n, ratio in enumerate(ratios, 1))
    yield f"diag damping, {len(ratios)}, {', '.join(pairs)},"


def _rayleigh(found: RayleighDamping) -> Iterator[str]:
    yield f"rayleigh damping, {real(found.alpha_1_s)}, {real(found.beta_s)},"


_NOTES = (
    "The line belongs in joint: LABEL, modal, ..., before the FEM data file.",
    "Numbers are those of the modes in the FEM data file; modes without a number here are undamped.",
    "Since MBDyn 1.7.1 a factor is a fraction of critical damping, c = 2 zeta sqrt(k m).",
)
MBDYN = Code("mbdyn", "MBDyn", "#", _NOTES, _modal, _rayleigh)

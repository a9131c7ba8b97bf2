"""Ansys Mechanical APDL: ratios by mode number."""

from __future__ import annotations

from collections.abc import Iterator

from modalcam.apps.deck.code import Code, fill, real
from modalcam.apps.deck.damping import Damping
from sim.damping import RayleighDamping


def _modal(damping: Damping) -> Iterator[str]:
    for k, group in enumerate(fill(map(real, damping.ratios()), 6)):
        yield f"MDAMP,{6 * k + 1},{','.join(group)}"


def _multipliers(found: RayleighDamping) -> Iterator[str]:
    yield f"ALPHAD,{real(found.alpha_1_s)}"
    yield f"BETAD,{real(found.beta_s)}"


_NOTES = (
    "MDAMP acts in mode-superposition and spectrum analyses only, by the number of the mode.",
    "It is added to DMPRAT, ALPHAD and BETAD: leave them out. Modes above the last are undamped.",
    "DMPSTR is g = 2 zeta, but MP,DMPR is zeta.",
)
ANSYS = Code("ansys", "Ansys", "!", _NOTES, _modal, _multipliers)

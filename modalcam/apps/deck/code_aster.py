"""Code_Aster: ratios of the modes of a modal basis."""

from __future__ import annotations

from collections.abc import Iterator

from modalcam.apps.deck.code import Code, real
from modalcam.apps.deck.damping import Damping
from sim.damping import RayleighDamping


def _modal(damping: Damping) -> Iterator[str]:
    yield f"AMOR_MODAL=_F(AMOR_REDUIT=({', '.join(map(real, damping.ratios()))},)),"


def _material(found: RayleighDamping) -> Iterator[str]:
    yield f"AMOR_ALPHA={real(found.beta_s)}, AMOR_BETA={real(found.alpha_1_s)},"


_NOTES = (
    "AMOR_MODAL is a keyword of DYNA_VIBRA; in a transient on the physical basis add MODE_MECA=modes within it.",
    "The ratios belong to mode numbers of the basis; further modes repeat the last one.",
    "AMOR_ALPHA and AMOR_BETA, of ELAS in DEFI_MATERIAU, are reversed: AMOR_ALPHA (s) is on the stiffness.",
)
CODE_ASTER = Code("code_aster", "Code_Aster", "#", _NOTES, _modal, _material)

"""Project Chrono: ratios of the modes of a reduced assembly."""

from __future__ import annotations

from collections.abc import Iterator

from modalcam.apps.deck.code import Code, real
from modalcam.apps.deck.damping import Damping
from sim.damping import RayleighDamping


def _modal(damping: Damping) -> Iterator[str]:
    ratios = damping.ratios()
    yield f"chrono::ChVectorDynamic<> zeta({len(ratios)});"
    yield f"zeta << {', '.join(map(real, ratios))};"
    yield "chrono::modal::ChModalDampingFactorRmm damping(zeta);"


def _rayleigh(found: RayleighDamping) -> Iterator[str]:
    yield f"chrono::modal::ChModalDampingRayleigh damping({real(found.alpha_1_s)}, {real(found.beta_s)});"


_NOTES = (
    "C++; give damping to the modal reduction of a ChModalAssembly (DoModalReduction, earlier SwitchModalReductionON).",
    "The ratios are those of the internal modes, with the boundary nodes fixed: clamp the beam at a boundary node.",
    "Further modes repeat the last ratio; boundary nodes are undamped.",
)
CHRONO = Code("chrono", "Project Chrono", "//", _NOTES, _modal, _rayleigh)

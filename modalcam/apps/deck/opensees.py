"""OpenSees: ratios of the modes of the last eigen command."""

from __future__ import annotations

from collections.abc import Iterator

from modalcam.apps.deck.code import Code, real
from modalcam.apps.deck.damping import Damping
from sim.damping import RayleighDamping


def _modal(damping: Damping) -> Iterator[str]:
    ratios = damping.ratios()
    yield f"eigen {len(ratios)}"
    yield f"modalDamping {' '.join(map(real, ratios))}"


def _rayleigh(found: RayleighDamping) -> Iterator[str]:
    yield f"rayleigh {real(found.alpha_1_s)} {real(found.beta_s)} 0.0 0.0"


_NOTES = (
    "Tcl; in OpenSeesPy each command is a function of that name.",
    "The ratios belong to mode numbers of this eigen command; modes above the last are undamped.",
    "modalDamping changes forces, not the tangent: iterate (no Linear algorithm, no explicit integrator).",
    "rayleigh (on the mass; the current, initial and committed stiffness) acts on elements defined before it.",
)
OPENSEES = Code("opensees", "OpenSees", "#", _NOTES, _modal, _rayleigh)

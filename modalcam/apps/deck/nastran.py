"""Nastran and OptiStruct: a table of damping over frequency, selected in the case control."""

from __future__ import annotations

import re
from collections.abc import Iterator

from modalcam.apps.deck.code import Code, fill
from modalcam.apps.deck.damping import Damping
from sim.damping import RayleighDamping


def _table(damping: Damping) -> Iterator[str]:
    rows = damping.table()
    # Outside, the table continues the line through its two last points.
    rows = ((0.0, rows[0][1]), *rows, (2.0 * rows[-1][0], rows[-1][1]))
    yield "TABDMP1,10,CRIT"
    yield from (
        f"+,{','.join(group)}" for group in fill([*(field(v) for row in rows for v in row), "ENDT"], 8)
    )


def _parameters(found: RayleighDamping) -> Iterator[str]:
    yield f"PARAM,ALPHA1,{field(found.alpha_1_s)}"
    yield f"PARAM,ALPHA2,{field(found.beta_s)}"


def field(value: float) -> str:
    """A real number in the eight characters of a small field, such as 1.1489-5."""
    texts = (f"{value:#.{digits}g}".removeprefix("0") for digits in range(7, 0, -1))
    return next(text for text in (re.sub("e([+-])0*", r"\1", t) for t in texts) if len(text) <= 8)


_NOTES = (
    "Select the table in the case control: SDAMPING = 10. It acts in modal solutions with METHOD. Frequencies in Hz.",
    "CRIT is the fraction of critical damping; without it the type is G = 2 zeta. PARAM,G is 2 zeta and adds.",
    "The first and last ratio are repeated, since the table is extrapolated linearly.",
    "In a transient, PARAM,G acts only with PARAM,W3, in rad/s: the frequency at which it is G.",
)
_MSC = (
    "Without PARAM,ALPHA1 and ALPHA2 (MSC, NX) use PARAM,G = beta W3 with PARAM,W3, which leaves out alpha."
)
_INDEX = "TABDMP2 would be a table over mode numbers."
NASTRAN = Code("nastran", "Nastran", "$", (*_NOTES, _MSC), _table, _parameters)
OPTISTRUCT = Code("optistruct", "OptiStruct", "$", (*_NOTES, _INDEX), _table, _parameters)

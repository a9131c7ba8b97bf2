"""Registry of the simulation codes that decks are written for.

A new one is a `Code` in a separate file and one entry here, or a call of `register_code` in a plugin.
"""

from __future__ import annotations

from modalcam.apps.deck import abaqus, ansys, chrono, code_aster, exudyn, mbdyn, nastran, opensees
from modalcam.apps.deck.code import Code
from modalcam.apps.deck.damping import Damping
from modalcam.common import InputError, shown

CODES: dict[str, Code] = {
    code.name: code
    for code in (
        abaqus.ABAQUS,
        ansys.ANSYS,
        abaqus.CALCULIX,
        chrono.CHRONO,
        code_aster.CODE_ASTER,
        exudyn.EXUDYN,
        mbdyn.MBDYN,
        nastran.NASTRAN,
        opensees.OPENSEES,
        nastran.OPTISTRUCT,
    )
}


def register_code(code: Code) -> None:
    """Add a simulation code, whose name must be new; ValueError otherwise."""
    if CODES.setdefault(code.name, code) is not code:
        msg = f"a code named {code.name!r} is registered already; choose another name"
        raise ValueError(msg)


def deck(damping: Damping, name: str) -> str:
    """Lines of damping for the code of this name; InputError for an unknown one."""
    if name not in CODES:
        msg = f"--code: expected one of {', '.join(CODES)}; found {shown(name)}"
        raise InputError(msg)
    return CODES[name].text(damping)

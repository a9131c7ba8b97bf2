"""The simulation codes that decks are written for, what their lines are made of, and their registry.

A new one is a `Code` here and one entry in `CODES`, or a call of `register_code` in a plugin.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from modalcam.apps.deck.damping import DampedMode, Damping
from modalcam.common import InputError, shown
from sim.damping import RayleighDamping

_WIDTH = 72
# Of names and sentences: no code takes one of these for the end of a comment or a continued line.
_UNSAFE = re.compile(r"[^A-Za-z0-9 .,:;()/+=%<>'*_-]")


@dataclass(frozen=True)
class Code:
    """A simulation code.

    Attributes
    ----------
    name : str
        As ``--code`` names it.
    title : str
        As its makers write it.
    comment : str
        What a line of comment begins with.
    notes : tuple of str
        What its user must know: where the lines belong, what is added to them, what happens to other modes.
    modal : callable
        Lines with the damping ratio of each mode.
    rayleigh : callable
        Lines with alpha (1/s, on the mass) and beta (s, on the stiffness), for analyses without modes.
    """

    name: str
    title: str
    comment: str
    notes: tuple[str, ...]
    modal: Callable[[Damping], Iterable[str]]
    rayleigh: Callable[[RayleighDamping], Iterable[str]]

    def text(self, damping: Damping) -> str:
        """The deck: comments, the modal lines, and the Rayleigh lines as comments."""
        between = ", ".join(map(str, damping.between))
        said = [
            f"Damping for {self.title}.",
            *damping.provenance,
            *(f"Left out: {reason}." for reason in damping.left_out),
            _NUMBERS,
            *self.notes,
            *(
                [f"Not measured: mode {between}. Where modes are counted, its ratio is interpolated."]
                if between
                else []
            ),
            *(line for mode in damping.modes for line in _measured(mode)),
        ]
        lines = [*self._comments(said), *self.modal(damping), *self._alternative(damping)]
        return "".join(f"{line}\n" for line in lines)

    def _alternative(self, damping: Damping) -> Iterator[str]:
        found = damping.rayleigh
        if found is None:
            yield from self._comments(["Rayleigh damping needs two measured modes."])
            return
        omega = 2.0 * np.pi * np.array([mode.frequency_hz for mode in damping.modes])
        shares = found.damping_ratio(omega) / [mode.damping_ratio for mode in damping.modes]
        misfit = (f"{100.0 * s:.1f} % in mode {m.number}" for m, s in zip(damping.modes, shares, strict=True))
        sentence = (
            f"Rayleigh damping, in place of the lines above and not with them: alpha {real(found.alpha_1_s)} 1/s, beta "
            f"{real(found.beta_s)} s, least squares over all modes. Of the measured ratio it gives {', '.join(misfit)}."
        )
        yield from self._comments([sentence])
        yield from (f"{self.comment} {line}" for line in self.rayleigh(found))

    def _comments(self, sentences: Iterable[str]) -> Iterator[str]:
        for sentence in sentences:
            for line in textwrap.wrap(_UNSAFE.sub("_", sentence), _WIDTH):
                yield f"{self.comment} {line}"


_NUMBERS = (
    "Mode numbers count the bending modes in the filmed plane. A model also has modes across it, of torsion and along "
    "the axis: compare frequencies before you use a number."
)


def _measured(mode: DampedMode) -> Iterator[str]:
    yield (
        f"mode {mode.number}: {mode.frequency_hz:.6g} Hz, damping ratio {mode.damping_ratio:.5g}, 90 % interval "
        f"{mode.low:.5g} to {mode.high:.5g}"
    )
    yield from mode.remarks


def real(value: float) -> str:
    """A number with six significant digits and a decimal point or an exponent, as all of these codes read it."""
    return repr(float(f"{value:.6g}"))


def fill(words: Iterable[str], count: int) -> Iterator[tuple[str, ...]]:
    """Groups of at most `count` words."""
    rest = tuple(words)
    while rest:
        yield rest[:count]
        rest = rest[count:]


# Abaqus and CalculiX, whose keywords are alike: ratios by frequency or by mode, Rayleigh damping of a material.
def _abaqus_modal(damping: Damping) -> Iterator[str]:
    yield "*MODAL DAMPING, VISCOUS=FRACTION OF CRITICAL DAMPING, DEFINITION=FREQUENCY RANGE"
    yield from (f"{real(frequency)}, {real(ratio)}" for frequency, ratio in damping.table())


def _calculix_modal(damping: Damping) -> Iterator[str]:
    yield "*MODAL DAMPING"
    yield from (f"{n}, {n}, {real(ratio)}" for n, ratio in enumerate(damping.ratios(), 1))


def _abaqus_material(found: RayleighDamping) -> Iterator[str]:
    yield f"*DAMPING, ALPHA={real(found.alpha_1_s)}, BETA={real(found.beta_s)}"


_ABAQUS_NOTES = (
    "The modal lines belong in the step of a mode-based procedure: frequencies in Hz, fractions of critical damping.",
    "Ratios are linear between frequencies and constant outside; *SELECT EIGENMODES needs the same DEFINITION.",
    "*DAMPING belongs in *MATERIAL; mode-based steps without SIM ignore it. STRUCTURAL would be 2 zeta.",
)
_CALCULIX_NOTES = (
    "The modal lines belong in *MODAL DYNAMIC or *STEADY STATE DYNAMICS: first and last mode, fraction of critical.",
    "Modes above the last line are undamped. *DAMPING, STRUCTURAL would be 2 zeta.",
    "*DAMPING belongs in *MATERIAL, once in a deck, for direct *DYNAMIC. By modes, alpha and beta are",
    "*MODAL DAMPING,RAYLEIGH and in the next line ,,alpha,beta.",
)
ABAQUS = Code("abaqus", "Abaqus", "**", _ABAQUS_NOTES, _abaqus_modal, _abaqus_material)
CALCULIX = Code("calculix", "CalculiX", "**", _CALCULIX_NOTES, _calculix_modal, _abaqus_material)


# Ansys Mechanical APDL: ratios by mode number.
def _ansys_modal(damping: Damping) -> Iterator[str]:
    for k, group in enumerate(fill(map(real, damping.ratios()), 6)):
        yield f"MDAMP,{6 * k + 1},{','.join(group)}"


def _ansys_multipliers(found: RayleighDamping) -> Iterator[str]:
    yield f"ALPHAD,{real(found.alpha_1_s)}"
    yield f"BETAD,{real(found.beta_s)}"


_ANSYS_NOTES = (
    "MDAMP acts in mode-superposition and spectrum analyses only, by the number of the mode.",
    "It is added to DMPRAT, ALPHAD and BETAD: leave them out. Modes above the last are undamped.",
    "DMPSTR is g = 2 zeta, but MP,DMPR is zeta.",
)
ANSYS = Code("ansys", "Ansys", "!", _ANSYS_NOTES, _ansys_modal, _ansys_multipliers)


# Project Chrono: ratios of the modes of a reduced assembly.
def _chrono_modal(damping: Damping) -> Iterator[str]:
    ratios = damping.ratios()
    yield f"chrono::ChVectorDynamic<> zeta({len(ratios)});"
    yield f"zeta << {', '.join(map(real, ratios))};"
    yield "chrono::modal::ChModalDampingFactorRmm damping(zeta);"


def _chrono_rayleigh(found: RayleighDamping) -> Iterator[str]:
    yield f"chrono::modal::ChModalDampingRayleigh damping({real(found.alpha_1_s)}, {real(found.beta_s)});"


_CHRONO_NOTES = (
    "C++; give damping to the modal reduction of a ChModalAssembly (DoModalReduction, earlier SwitchModalReductionON).",
    "The ratios are those of the internal modes, with the boundary nodes fixed: clamp the beam at a boundary node.",
    "Further modes repeat the last ratio; boundary nodes are undamped.",
)
CHRONO = Code("chrono", "Project Chrono", "//", _CHRONO_NOTES, _chrono_modal, _chrono_rayleigh)


# Code_Aster: ratios of the modes of a modal basis.
def _code_aster_modal(damping: Damping) -> Iterator[str]:
    yield f"AMOR_MODAL=_F(AMOR_REDUIT=({', '.join(map(real, damping.ratios()))},)),"


def _code_aster_material(found: RayleighDamping) -> Iterator[str]:
    yield f"AMOR_ALPHA={real(found.beta_s)}, AMOR_BETA={real(found.alpha_1_s)},"


_CODE_ASTER_NOTES = (
    "AMOR_MODAL is a keyword of DYNA_VIBRA; in a transient on the physical basis add MODE_MECA=modes within it.",
    "The ratios belong to mode numbers of the basis; further modes repeat the last one.",
    "AMOR_ALPHA and AMOR_BETA, of ELAS in DEFI_MATERIAU, are reversed: AMOR_ALPHA (s) is on the stiffness.",
)
CODE_ASTER = Code("code_aster", "Code_Aster", "#", _CODE_ASTER_NOTES, _code_aster_modal, _code_aster_material)


# Exudyn: a damping matrix of the measured modes, for an object on the nodes of the beam.
_EXUDYN_MATRIX = """\
def modal_damping_matrix(mass, stiffness, free):
    matrix, free = np.zeros(mass.shape), np.ix_(free, free)
    omega_squared, shapes = eigh(stiffness[free], mass[free], subset_by_index=[0, len(ZETA) - 1])
    moved = mass[free] @ shapes
    matrix[free] = moved * (2.0 * ZETA * np.sqrt(omega_squared)) @ moved.T
    return matrix"""


def _exudyn_modal(damping: Damping) -> Iterator[str]:
    yield from ("import numpy as np", "from scipy.linalg import eigh")
    yield f"ZETA = np.array([{', '.join(map(real, damping.ratios()))}])"
    yield from _EXUDYN_MATRIX.split("\n")


def _exudyn_rayleigh(found: RayleighDamping) -> Iterator[str]:
    yield f"ALPHA_1_S, BETA_S = {real(found.alpha_1_s)}, {real(found.beta_s)}"


_EXUDYN_NOTES = (
    "Python. mass, stiffness, _ = mbs.ComputeLinearizedSystem(...) at the equilibrium, for the nodes of the beam.",
    "free: indices of the coordinates that no constraint fixes. Then, in a new model,",
    "AddObject(ObjectGenericODE2(nodeNumbers=nodes, dampingMatrix=modal_damping_matrix(mass, stiffness, free))).",
    "The ratios belong to mode numbers of this model; further modes are undamped.",
    "Rayleigh: Cable2D(physicsBendingDamping=BETA_S*EI, physicsAxialDamping=BETA_S*EA), in N m2 s and N s,",
    "and dampingMatrix=ALPHA_1_S*mass of an ObjectGenericODE2.",
)
EXUDYN = Code("exudyn", "Exudyn", "#", _EXUDYN_NOTES, _exudyn_modal, _exudyn_rayleigh)


# MBDyn: ratios within a modal joint.
def _mbdyn_modal(damping: Damping) -> Iterator[str]:
    ratios = damping.ratios()
    pairs = (f"{n}, {real(ratio)}" for n, ratio in enumerate(ratios, 1))
    yield f"diag damping, {len(ratios)}, {', '.join(pairs)},"


def _mbdyn_rayleigh(found: RayleighDamping) -> Iterator[str]:
    yield f"rayleigh damping, {real(found.alpha_1_s)}, {real(found.beta_s)},"


_MBDYN_NOTES = (
    "The line belongs in joint: LABEL, modal, ..., before the FEM data file.",
    "Numbers are those of the modes in the FEM data file; modes without a number here are undamped.",
    "Since MBDyn 1.7.1 a factor is a fraction of critical damping, c = 2 zeta sqrt(k m).",
)
MBDYN = Code("mbdyn", "MBDyn", "#", _MBDYN_NOTES, _mbdyn_modal, _mbdyn_rayleigh)


# Nastran and OptiStruct: a table of damping over frequency, selected in the case control.
def _nastran_table(damping: Damping) -> Iterator[str]:
    rows = damping.table()
    # Outside, the table continues the line through its two last points.
    rows = ((0.0, rows[0][1]), *rows, (2.0 * rows[-1][0], rows[-1][1]))
    yield "TABDMP1,10,CRIT"
    yield from (
        f"+,{','.join(group)}" for group in fill([*(field(v) for row in rows for v in row), "ENDT"], 8)
    )


def _nastran_parameters(found: RayleighDamping) -> Iterator[str]:
    yield f"PARAM,ALPHA1,{field(found.alpha_1_s)}"
    yield f"PARAM,ALPHA2,{field(found.beta_s)}"


def field(value: float) -> str:
    """A real number in the eight characters of a small field, such as 1.1489-5."""
    texts = (f"{value:#.{digits}g}".removeprefix("0") for digits in range(7, 0, -1))
    return next(text for text in (re.sub("e([+-])0*", r"\1", t) for t in texts) if len(text) <= 8)


_NASTRAN_NOTES = (
    "Select the table in the case control: SDAMPING = 10. It acts in modal solutions with METHOD. Frequencies in Hz.",
    "CRIT is the fraction of critical damping; without it the type is G = 2 zeta. PARAM,G is 2 zeta and adds.",
    "The first and last ratio are repeated, since the table is extrapolated linearly.",
    "In a transient, PARAM,G acts only with PARAM,W3, in rad/s: the frequency at which it is G.",
)
_MSC = (
    "Without PARAM,ALPHA1 and ALPHA2 (MSC, NX) use PARAM,G = beta W3 with PARAM,W3, which leaves out alpha."
)
_INDEX = "TABDMP2 would be a table over mode numbers."
NASTRAN = Code("nastran", "Nastran", "$", (*_NASTRAN_NOTES, _MSC), _nastran_table, _nastran_parameters)
OPTISTRUCT = Code(
    "optistruct", "OptiStruct", "$", (*_NASTRAN_NOTES, _INDEX), _nastran_table, _nastran_parameters
)


# OpenSees: ratios of the modes of the last eigen command.
def _opensees_modal(damping: Damping) -> Iterator[str]:
    ratios = damping.ratios()
    yield f"eigen {len(ratios)}"
    yield f"modalDamping {' '.join(map(real, ratios))}"


def _opensees_rayleigh(found: RayleighDamping) -> Iterator[str]:
    yield f"rayleigh {real(found.alpha_1_s)} {real(found.beta_s)} 0.0 0.0"


_OPENSEES_NOTES = (
    "Tcl; in OpenSeesPy each command is a function of that name.",
    "The ratios belong to mode numbers of this eigen command; modes above the last are undamped.",
    "modalDamping changes forces, not the tangent: iterate (no Linear algorithm, no explicit integrator).",
    "rayleigh (on the mass; the current, initial and committed stiffness) acts on elements defined before it.",
)
OPENSEES = Code("opensees", "OpenSees", "#", _OPENSEES_NOTES, _opensees_modal, _opensees_rayleigh)


CODES: dict[str, Code] = {
    code.name: code
    for code in (
        *(ABAQUS, ANSYS, CALCULIX, CHRONO, CODE_ASTER),
        *(EXUDYN, MBDYN, NASTRAN, OPENSEES, OPTISTRUCT),
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

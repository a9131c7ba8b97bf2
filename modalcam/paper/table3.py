"""Table 3: natural frequencies line by line, printed, recomputed, and of these recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modalcam.paper.recomputed import HANDBOOK_DENSITY_KG_M3, MODES, Recomputed
from modalcam.paper.text import largest
from modalcam.pipeline.results import BeamResult
from sim.reference import paper_tables as printed
from sim.updating import ModelComparison, Updating
from tracker.arrays import FloatArray


@dataclass(frozen=True)
class Line:
    """Frequencies from one source; `error` is relative to the group's reference, NaN for the reference itself."""

    label: str
    source: str
    frequency_hz: FloatArray
    error: FloatArray
    is_printed: bool = False

    @property
    def largest(self) -> float:
        """Largest absolute error; NaN for a reference."""
        return largest(self.error)


@dataclass(frozen=True)
class Group:
    """Lines for one column of the printed table; `against` names the reference of their errors."""

    title: str
    against: str
    lines: tuple[Line, ...]


@dataclass(frozen=True)
class Preference:
    """The most probable kind of beam, the best kind with the opposite choice of gravity, and the odds between them."""

    best: str
    rival: str
    odds: float


def groups(paper: Recomputed, beam: BeamResult | None) -> tuple[Group, ...]:
    """Standard and optimum column, then the recordings of this folder."""
    recorded = () if beam is None or beam.updated is None else (_recorded(beam, beam.updated),)
    return (_standard(paper), _optimum(paper), *recorded)


def _line(
    label: str, source: str, values: FloatArray, reference: FloatArray | None, *, is_printed: bool = False
) -> Line:
    values = np.asarray(values, dtype=np.float64)
    error = np.full(values.size, np.nan) if reference is None else values / reference - 1.0
    return Line(label, source, values, error, is_printed)


def _standard(paper: Recomputed) -> Group:
    column = np.array(printed.TABLE_3_STANDARD_HZ)
    density = printed.TABLE_1_STANDARD.density_kg_m3
    s = paper.standard
    return Group(
        "Standard properties",
        "the printed standard column",
        (
            _line("Paper, standard", "printed", column, None, is_printed=True),
            _line(
                f"Ours, {HANDBOOK_DENSITY_KG_M3:.0f} kg/m³", "without gravity", s.handbook_density_hz, column
            ),
            _line(f"Ours, {density:.0f} kg/m³ as printed", "without gravity", s.printed_density_hz, column),
            _line(f"Ours, {density:.0f} kg/m³ as printed", "hanging under gravity", s.hanging_hz, column),
        ),
    )


def _optimum(paper: Recomputed) -> Group:
    column, test = np.array(printed.TABLE_3_OPTIMUM_HZ), np.array(printed.TABLE_3_TEST_HZ)
    o = paper.optimum
    return Group(
        "Optimum properties",
        "the printed optimum column, or the test column where stated",
        (
            _line("Paper, test", "printed", test, None, is_printed=True),
            _line("Paper, optimum", "printed; against the test", column, test, is_printed=True),
            _line("Ours, the paper’s variables", "42, without gravity", o.reached.updated_hz, column),
            _line(
                "Ours, fitted to the test",
                "42, without gravity; against the test",
                o.to_test.paper.updated_hz,
                test,
            ),
            _line("Ours, Bayesian", "hanging under gravity; against the test", o.to_test.updated_hz, test),
            _line("Ours, Table 1’s optimum as uniform values", "without gravity", o.uniform_hz, column),
            _line("The same", "hanging under gravity", o.uniform_hanging_hz, column),
        ),
    )


def _recorded(beam: BeamResult, a: Updating) -> Group:
    def by_number(values: FloatArray) -> FloatArray:
        out = np.full(MODES, np.nan)
        inside = a.mode_numbers <= MODES
        out[a.mode_numbers[inside] - 1] = values[inside]
        return out

    measured = by_number(a.measured_hz)
    gravity = gravity_of(beam)
    variables = a.paper.start_spread.size
    lines = (
        _line("Measured, small amplitude", "these recordings", measured, None),
        _line("Beam as configured", "without gravity", by_number(a.paper.standard_hz), measured),
        _line("Beam as configured", gravity, by_number(a.standard_hz), measured),
        _line(
            "The paper’s variables", f"{variables}, without gravity", by_number(a.paper.updated_hz), measured
        ),
        _line("Uniform thickness", gravity, by_number(a.uniform.updated_hz), measured),
        _line("Bayesian, most probable", gravity, by_number(a.bayesian.updated_hz), measured),
    )
    return Group("These recordings", "the measured frequencies", lines)


def gravity_of(beam: BeamResult) -> str:
    """``hanging under gravity``, of the beam as configured."""
    orientation = beam.standard.orientation
    return "without gravity" if orientation == "none" else f"{orientation} under gravity"


def preference(evidence: ModelComparison) -> Preference | None:
    """Kind of beam that the frequencies favour; None if all kinds have the same choice of gravity."""
    best = evidence.models[0]
    gravity = best.name.endswith("+gravity")
    rival = next((m for m in evidence.models if m.name.endswith("+gravity") != gravity), None)
    if rival is None:
        return None
    return Preference(_kind(best.name), _kind(rival.name), float(np.exp(evidence.odds(rival.name))))


def _kind(name: str) -> str:
    """``smoothly varying beam under gravity`` for the updating's name of a model."""
    shape = {"uniform": "uniform beam", "taper": "tapered beam", "smooth": "smoothly varying beam"}
    form = name.removesuffix("+gravity")
    return shape.get(form, form) + (" under gravity" if name != form else " without gravity")

"""Table 3: natural frequencies line by line, printed, recomputed, and of these recordings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from modalcam.apps.paper.recomputed import HANDBOOK_DENSITY_KG_M3, MODES, Recomputed
from modalcam.pipeline import BeamResult
from sim import reference as printed
from sim.updating import Updating
from tracker import FloatArray


class Line(NamedTuple):
    """Frequencies from one source, and those that they are compared with (their own where there are none)."""

    label: str
    source: str
    frequency_hz: FloatArray
    reference_hz: FloatArray | None = None

    @property
    def is_printed(self) -> bool:
        """Whether the paper gives these frequencies."""
        return self.source.startswith("printed")

    @property
    def error(self) -> FloatArray:
        """Relative to the reference; NaN without one."""
        if self.reference_hz is None:
            return np.full(self.frequency_hz.size, np.nan)
        return self.frequency_hz / self.reference_hz - 1.0


class Group(NamedTuple):
    """Lines for one column of the printed table; `against` names the reference of their errors."""

    title: str
    against: str
    lines: tuple[Line, ...]


def groups(paper: Recomputed, beam: BeamResult | None) -> tuple[Group, ...]:
    """Standard and optimum column, then the recordings of this folder."""
    standard, optimum, test = (
        np.array(column)
        for column in (printed.TABLE_3_STANDARD_HZ, printed.TABLE_3_OPTIMUM_HZ, printed.TABLE_3_TEST_HZ)
    )
    s, o = paper.standard, paper.optimum
    as_printed = f"Ours, {printed.TABLE_1_STANDARD.density_kg_m3:.0f} kg/m³ as printed"
    handbook = f"Ours, {HANDBOOK_DENSITY_KG_M3:.0f} kg/m³"
    like_paper, fitted = o.reached.updated_hz, o.to_test.paper.updated_hz
    out = [
        Group(
            "Standard properties",
            "the printed standard column",
            (
                Line("Paper, standard", "printed", standard),
                Line(handbook, "without gravity", s.handbook_density_hz, standard),
                Line(as_printed, "without gravity", s.printed_density_hz, standard),
                Line(as_printed, "hanging under gravity", s.hanging_hz, standard),
            ),
        ),
        Group(
            "Optimum properties",
            "the printed optimum column, or the test column where stated",
            (
                Line("Paper, test", "printed", test),
                Line("Paper, optimum", "printed; against the test", optimum, test),
                Line("Ours, the paper’s variables", "42, without gravity", like_paper, optimum),
                Line("Ours, fitted to the test", "42, without gravity; against the test", fitted, test),
                Line("Ours, Bayesian", "hanging under gravity; against the test", o.to_test.updated_hz, test),
                Line("Ours, Table 1’s optimum as uniform values", "without gravity", o.uniform_hz, optimum),
                Line("The same", "hanging under gravity", o.uniform_hanging_hz, optimum),
            ),
        ),
    ]
    if beam is not None and beam.updated is not None:
        out.append(_recorded(beam.updated, gravity_of(beam)))
    return tuple(out)


def _recorded(a: Updating, gravity: str) -> Group:
    def line(label: str, source: str, values: FloatArray, reference: FloatArray | None = None) -> Line:
        by_number = np.full(MODES, np.nan)
        inside = a.mode_numbers <= MODES
        by_number[a.mode_numbers[inside] - 1] = values[inside]
        return Line(label, source, by_number, reference)

    measured = line("Measured, small amplitude", "these recordings", a.measured_hz)
    against = measured.frequency_hz
    variables = f"{a.paper.start_spread.size}, without gravity"
    lines = (
        measured,
        line("Beam as configured", "without gravity", a.paper.standard_hz, against),
        line("Beam as configured", gravity, a.standard_hz, against),
        line("The paper’s variables", variables, a.paper.updated_hz, against),
        line("Uniform thickness", gravity, a.uniform.updated_hz, against),
        line("Bayesian, most probable", gravity, a.bayesian.updated_hz, against),
    )
    return Group("These recordings", "the measured frequencies", lines)


def gravity_of(beam: BeamResult) -> str:
    """``hanging under gravity``, of the beam as configured."""
    orientation = beam.standard.orientation
    return "without gravity" if orientation == "none" else f"{orientation} under gravity"

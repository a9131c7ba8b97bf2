"""Table 3: natural frequencies line by line, the paper's and what they come to here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modalcam.paper.bounds import ending_at_bound, least_bound
from modalcam.paper.recomputed import HANDBOOK_DENSITY_KG_M3, MODES, Recomputed
from modalcam.paper.recorded import beam_differences, by_number
from modalcam.paper.words import hertz, largest, listed, signed_percent, signed_range, within
from modalcam.pipeline.results import BeamResult
from modalcam.report.style.format import MISSING, fixed, percent, significant
from sim.reference import paper_tables as printed
from sim.updating import ModelComparison, Updating
from tracker.arrays import FloatArray


@dataclass(frozen=True)
class Line:
    """Frequencies of one source; `error` is relative to `against`, empty where it is a reference itself."""

    label: str
    source: str
    frequency_hz: FloatArray
    error: FloatArray
    is_printed: bool

    @property
    def largest(self) -> float:
        """Largest modulus of the errors; NaN for a reference."""
        return largest(self.error)

    @property
    def texts(self) -> tuple[tuple[str, str, float], ...]:
        """Frequency, error and full value of each mode."""
        digits = 2 if self.is_printed else 3
        return tuple(
            (fixed(float(f), digits), "" if np.isnan(e) else _error(float(e)), float(f))
            for f, e in zip(self.frequency_hz, self.error, strict=True)
        )

    @property
    def largest_text(self) -> str:
        """`largest` in per cent."""
        return MISSING if np.isnan(self.largest) else _error(self.largest).removeprefix("+")


def _error(relative: float) -> str:
    """In per cent; what is less than anyone measures is not spelt out."""
    return "< 0.0001 %" if abs(relative) < 1e-6 else signed_percent(relative)


@dataclass(frozen=True)
class Group:
    """Lines that belong to one column of the printed table; `against` says what their errors are relative to."""

    title: str
    against: str
    lines: tuple[Line, ...]


def groups(paper: Recomputed, beam: BeamResult | None) -> tuple[Group, ...]:
    """The printed columns with what stands beside each, then this folder's own."""
    return (
        _standard(paper),
        _optimum(paper),
        *((_recorded(beam, beam.updated),) if beam is not None and beam.updated is not None else ()),
    )


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
    column = np.array(printed.TABLE_3_OPTIMUM_HZ)
    test = np.array(printed.TABLE_3_TEST_HZ)
    o = paper.optimum
    return Group(
        "Optimum properties",
        "the printed optimum column, the test column where the line says so",
        (
            _line("Paper, test", "printed", test, None, is_printed=True),
            _line("Paper, optimum", "printed; against the test", column, test, is_printed=True),
            _line("Ours, the paper’s variables", "42, without gravity", o.reached.updated_hz, column),
            _line(
                "Ours, aimed at the test",
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
    def spread(values: FloatArray) -> FloatArray:
        return by_number(a.mode_numbers, values, MODES)

    measured = spread(a.measured_hz)
    gravity = _gravity(beam.standard.orientation)
    variables = a.paper.start_spread.size
    lines = (
        _line("Measured, small amplitude", "these recordings", measured, None),
        _line("Beam as configured", "without gravity", spread(a.paper.standard_hz), measured),
        _line("Beam as configured", gravity, spread(a.standard_hz), measured),
        _line("The paper’s variables", f"{variables}, without gravity", spread(a.paper.updated_hz), measured),
        _line("Uniform thickness", gravity, spread(a.uniform.updated_hz), measured),
        _line("Bayesian, most probable", gravity, spread(a.bayesian.updated_hz), measured),
    )
    return Group("These recordings", "the measured frequencies", lines)


def _gravity(orientation: str) -> str:
    return "without gravity" if orientation == "none" else f"{orientation} under gravity"


def sentences(paper: Recomputed, beam: BeamResult | None) -> tuple[str, ...]:
    """What the table shows, from its numbers."""
    return (
        *_about_standard(paper),
        *_about_optimum(paper),
        *(_about_recorded(beam, beam.updated) if beam is not None and beam.updated is not None else ()),
    )


def _about_standard(paper: Recomputed) -> tuple[str, ...]:
    column, test = np.array(printed.TABLE_3_STANDARD_HZ), np.array(printed.TABLE_3_TEST_HZ)
    density, s = printed.TABLE_1_STANDARD.density_kg_m3, paper.standard
    hidden = largest(s.handbook_density_hz / column - 1.0)
    as_printed = s.printed_density_hz / column - 1.0
    free, hanging = s.printed_density_hz / test - 1.0, s.hanging_hz / test - 1.0
    return (
        (
            f"Without gravity and with {HANDBOOK_DENSITY_KG_M3:.0f} kg/m³ the standard column comes out "
            f"within {within(hidden)}; with the printed {density:.0f} kg/m³ it is off by "
            f"{signed_range(as_printed)}. The density that fits the five frequencies best is "
            f"{s.best_density_kg_m3:.0f} kg/m³."
        ),
        (
            "The beam hangs, and the printed column knows no gravity. With it the same beam has "
            f"{hertz(s.hanging_hz[0])} Hz in mode 1, {signed_percent(float(hanging[0]))} from the test, where "
            f"it has {signed_percent(float(free[0]))} without; the other modes remain "
            f"{signed_range(hanging[1:])} from the test. Standing it would have {hertz(s.standing_hz[0])} Hz."
        ),
    )


def _about_optimum(paper: Recomputed) -> tuple[str, ...]:
    column, test = np.array(printed.TABLE_3_OPTIMUM_HZ), np.array(printed.TABLE_3_TEST_HZ)
    o = paper.optimum
    count = o.reached.start_spread.size
    bound = percent(o.reached.bound)
    reached = largest(o.reached.updated_hz / column - 1.0)
    ours, theirs = largest(o.to_test.paper.updated_hz / test - 1.0), largest(column / test - 1.0)
    out = [
        (
            f"The paper’s {count} variables, each within {bound}, reach the printed optimum column within "
            f"{within(reached)}; {ending_at_bound(o.reached)}. {least_bound(o.reached)}"
        ),
        (
            "Taken as uniform values, Table 1’s optimum gives frequencies "
            f"{signed_range(o.uniform_hz / column - 1.0)} from Table 3’s optimum "
            f"({signed_range(o.uniform_hanging_hz / column - 1.0)} hanging): what Table 1 lists is not the "
            "beam that Table 3 was computed with, at best its average."
        ),
    ]
    if theirs > ours:
        out.append(
            f"The printed optimum misses the test by up to {percent(theirs)}, which the same variables reach "
            f"within {within(ours)}: its search ended early, or the shapes that it matched as well held it off."
        )
    return (*out, *_evidence("The test column itself speaks", o.to_test.evidence))


def _evidence(who: str, evidence: ModelComparison) -> tuple[str, ...]:
    """Which kind of beam the frequencies speak for, and how much more than for the best with, or without, gravity."""
    best = evidence.models[0]
    gravity = best.name.endswith("+gravity")
    rival = next((m for m in evidence.models if m.name.endswith("+gravity") != gravity), None)
    if rival is None:
        return ()
    odds = significant(float(np.exp(evidence.odds(rival.name))), 2)
    return (
        (
            f"{who} for a {_kind(best.name)}: its marginal likelihood is {odds} times that of the most "
            f"probable beam {'without' if gravity else 'under'} gravity, a {_kind(rival.name)}."
        ),
    )


def _kind(name: str) -> str:
    """``smoothly varying beam under gravity`` for the updating's name of a model."""
    shape = {"uniform": "uniform beam", "taper": "tapering beam", "smooth": "smoothly varying beam"}
    form = name.removesuffix("+gravity")
    return shape.get(form, form) + (" under gravity" if name != form else "")


def _about_recorded(beam: BeamResult, a: Updating) -> tuple[str, ...]:
    measured, count = a.measured_hz, a.paper.start_spread.size
    out = []
    differences = beam_differences(beam.standard)
    if differences:
        out.append(
            f"The beam configured here is not that of Table 1: {listed(differences)}. Its lines are "
            "comparable with each other, not with the printed ones."
        )
    reached = largest(a.paper.updated_hz / measured - 1.0)
    out.append(
        f"For these recordings the paper’s {count} variables reach the measured frequencies within "
        f"{within(reached)}; {ending_at_bound(a.paper)}. {least_bound(a.paper)}"
    )
    out.append(
        f"One factor on the thickness ({fixed(a.uniform.thickness_factor, 3)}), "
        f"{_gravity(beam.standard.orientation)}, leaves {signed_range(a.uniform.updated_hz / measured - 1.0)}."
    )
    out.append(
        f"The most probable of the smooth beams, {_gravity(beam.standard.orientation)}, reaches the measured "
        f"frequencies within {within(largest(a.bayesian.updated_hz / measured - 1.0))}. The data decide "
        f"{a.bayesian.determined} directions of its {a.bayesian.log_factor.size} variables; the other "
        f"{a.bayesian.undetermined} are the prior’s."
    )
    if np.isfinite(a.bayesian.shape_rms):
        paper, uniform, bayesian = (significant(u.shape_rms, 2) for u in (a.paper, a.uniform, a.bayesian))
        out.append(
            f"The measured shapes, matched as well, are then missed by {paper} of their standard deviations (rms) with "
            f"the paper’s variables, {uniform} with the uniform thickness and {bayesian} with the smooth beam."
        )
    return (*out, *_evidence("These recordings speak", a.evidence))

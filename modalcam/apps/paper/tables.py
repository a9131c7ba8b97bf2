"""Tables 1 to 3 of the paper beside the recomputed ones, and Fig. 2 to 4: each decay and its simulations.

Table 1: properties of the beam, the paper's two rows and the answers from the same frequencies. Table 2: measured
natural frequencies and damping ratios. Table 3: natural frequencies line by line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from modal_id import Identification, IdentifiedMode
from modalcam.apps.paper.recomputed import HANDBOOK_DENSITY_KG_M3, MODES, Recomputed, TrueMode
from modalcam.pipeline import BeamResult, RecordingResult, RunResult
from modalcam.report import drawn_decays, nrmse_of_fit
from modalcam.report.style import MISSING, percent
from sim import reference as printed
from sim.beam import BeamProperties
from sim.comparison import DecayComparison, ModelDecay
from sim.updating import BayesianUpdate, PaperUpdate, Updating
from tracker import INTERVAL_ENDS, INTERVAL_LEVEL, Failure, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Threshold of the verdicts."""

    #: [1] a model whose damping is off by less predicts it
    #: convention: Chosen for the page.
    near: float = 0.05


TUNING = Tuning()


class Column(NamedTuple):
    """One answer, and the standard beam to which it is compared.

    `values` and `standard` are length, width and thickness in mm, density in kg/m³, modulus in MPa and E h² / ρ, each
    of shape (draws or 1, elements or 1); `at_bound` counts the variables at their bound, with `remark` in small print.
    """

    label: str
    source: str
    values: list[FloatArray]
    standard: list[FloatArray]
    at_bound: str = MISSING
    remark: str = ""


def table_1(paper: Recomputed, beam: BeamResult | None) -> tuple[Column, ...]:
    """The printed columns, the paper's variables fitted to its optimum column, and the answers from this folder."""
    row = _properties(printed.TABLE_1_STANDARD.beam("hanging"))
    optimum = _properties(printed.TABLE_1_OPTIMUM.beam("hanging"))
    limit = f"printed; limit {percent(printed.VARIABLE_BOUND)}"
    aim = "no gravity, for Table 3’s optimum"
    out = [
        Column("Paper, standard", "printed", row, row),
        Column("Paper, optimum", limit, optimum, row, "not stated"),
        _like_paper("Ours, the paper’s variables", aim, paper.optimum.reached, row),
    ]
    if beam is not None and beam.updated is not None:
        updated, row = beam.updated, _properties(beam.standard)
        gravity = "no gravity" if beam.standard.orientation == "none" else beam.standard.orientation
        uniform, drawn = _properties(updated.uniform.properties), _drawn(updated.bayesian, beam.standard)
        out += [
            _like_paper("Recordings, the paper’s variables", "no gravity", updated.paper, row),
            Column("Recordings, uniform", f"{gravity}, one factor on the thickness", uniform, row),
            Column("Recordings, Bayesian", f"{gravity}, posterior mean ± sd", drawn, row, remark="no bounds"),
        ]
    return tuple(out)


def _like_paper(label: str, source: str, update: PaperUpdate, standard: list[FloatArray]) -> Column:
    share, bound = f"{len(update.at_bound)} of {update.start_spread.size}", f"bound {percent(update.bound)}"
    return Column(label, source, _properties(update.properties), standard, share, bound)


def _properties(beam: BeamProperties) -> list[FloatArray]:
    return _with_stiffness(
        np.array([[1e3 * beam.length_m]]),
        1e3 * beam.width_m[None],
        1e3 * beam.thickness_m[None],
        np.array([[beam.density_kg_m3]]),
        np.array([[1e-6 * beam.elastic_modulus_pa]]),
    )


def _drawn(update: BayesianUpdate, standard: BeamProperties) -> list[FloatArray]:
    """Properties of the draws from the posterior."""
    factor, ne = np.exp(update.log_factor_draws), standard.elements
    return _with_stiffness(
        np.full((factor.shape[0], 1), 1e3 * standard.length_m),
        1e3 * standard.width_m * factor[:, :ne],
        1e3 * standard.thickness_m * factor[:, ne : 2 * ne],
        standard.density_kg_m3 * factor[:, -2:-1],
        1e-6 * standard.elastic_modulus_pa * factor[:, -1:],
    )


def _with_stiffness(
    length: FloatArray, width: FloatArray, thickness: FloatArray, density: FloatArray, modulus: FloatArray
) -> list[FloatArray]:
    # Mean E h^2 / rho: without gravity, and for a given length, all that the frequencies of a uniform beam determine.
    stiffness = modulus * np.mean(thickness, axis=1, keepdims=True) ** 2 / density
    return [length, width, thickness, density, modulus, stiffness]


_NAN = float("nan")


@dataclass(frozen=True)
class Quantity:
    """A printed value of a mode and the measured one, in the unit of the table (Hz or per cent); unknown ones are NaN.

    `rounding` is half of the last digit printed, `truth` the simulated value.
    """

    number: int
    printed: float
    rounding: float
    truth: float
    value: float = _NAN
    sd: float = _NAN
    interval_90: tuple[float, float] = (_NAN, _NAN)
    interval_99: tuple[float, float] = (_NAN, _NAN)

    @property
    def difference(self) -> float:
        """Relative difference of the measured value from the printed one."""
        return self.value / self.printed - 1.0

    @property
    def apart(self) -> float:
        """Relative difference of the simulated value from the printed one."""
        return self.truth / self.printed - 1.0

    @property
    def level(self) -> float:
        """Level of the narrower interval that contains the printed value: 0.9, 0.99, or 1 for neither."""
        return self._level_of(self.printed)

    @property
    def truth_level(self) -> float:
        """The same for the simulated value."""
        return self._level_of(self.truth)

    def _level_of(self, value: float) -> float:
        for level, (low, high) in ((INTERVAL_LEVEL, self.interval_90), (0.99, self.interval_99)):
            if low <= value <= high:
                return level
        return 1.0

    @property
    def within_rounding(self) -> bool:
        """Whether the 99 % interval overlaps the range of values that are rounded to the printed one."""
        low, high = self.interval_99
        return low <= self.printed + self.rounding and high >= self.printed - self.rounding


@dataclass(frozen=True)
class Measured:
    """One mode of Table 2; without a recording and a mode if it was not measured."""

    number: int
    recording: str
    mode: IdentifiedMode | None
    frequency: Quantity
    damping: Quantity


def table_2(
    measured: dict[int, tuple[str, IdentifiedMode]], truth: dict[int, TrueMode] | Failure
) -> tuple[Measured, ...]:
    """The paper's five modes; `measured` gives recording and mode by number."""
    out = []
    known = {} if isinstance(truth, Failure) else truth
    values = zip(printed.TABLE_2_FREQUENCY_HZ, printed.TABLE_2_DAMPING_RATIO, strict=True)
    for number, (frequency_hz, ratio) in enumerate(values, 1):
        name, mode = measured.get(number, ("", None))
        f_draws, z_draws = (
            (mode.posterior.frequency_hz, mode.posterior.damping_ratio) if mode else (None, None)
        )
        true_hz, true_ratio = known.get(number, (_NAN, _NAN))
        frequency = _quantity(number, frequency_hz, printed.FREQUENCY_ROUNDING_HZ, true_hz, f_draws)
        damping = _quantity(number, ratio, printed.DAMPING_ROUNDING, true_ratio, z_draws, scale=100.0)
        out.append(Measured(number, name, mode, frequency, damping))
    return tuple(out)


def _quantity(
    number: int, value: float, rounding: float, truth: float, draws: FloatArray | None, *, scale: float = 1.0
) -> Quantity:
    """Printed, simulated and measured value, all multiplied by `scale`."""
    given = (number, scale * value, scale * rounding, scale * truth)
    if draws is None:
        return Quantity(*given)
    low, high = INTERVAL_ENDS
    low_99, low_90, median, high_90, high_99 = scale * np.quantile(draws, (0.005, low, 0.5, high, 0.995))
    return Quantity(*given, median, scale * float(np.std(draws)), (low_90, high_90), (low_99, high_99))


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


def table_3(paper: Recomputed, beam: BeamResult | None) -> tuple[Group, ...]:
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


PANELS = ("Fig. 2, left", "Fig. 2, right", "Fig. 3, left", "Fig. 3, right", "Fig. 4")


class Decay(NamedTuple):
    """One of the paper's panels: a recording of the mode, the identified mode, and its simulations."""

    number: int
    panel: str
    recording: RecordingResult
    found: Identification
    mode: IdentifiedMode
    comparison: DecayComparison
    models: tuple[ModelDecay, ...]

    @property
    def floor(self) -> float:
        """Normalised rms error of the fit of Eq. 1 itself."""
        return nrmse_of_fit(self.found)


class ModelRow(NamedTuple):
    """One damping model in one decay.

    `ratio` is the simulated over the measured damping ratio, `printed_ratio` the same by the paper's Table 2 (NaN for
    a model that the paper does not have).
    """

    decay: Decay
    model: ModelDecay
    ratio: float
    printed_ratio: float

    @property
    def number(self) -> int:
        """Number of the mode."""
        return self.decay.number

    @property
    def near(self) -> bool:
        """Whether the model predicts the measured damping within 5 %."""
        return abs(self.ratio - 1.0) < TUNING.near

    @property
    def as_printed(self) -> bool:
        """Whether the ratio agrees with that of the paper's Table 2 within 5 %."""
        return abs(self.ratio / self.printed_ratio - 1.0) < TUNING.near


def decays(result: RunResult, recordings: dict[int, str]) -> tuple[Decay, ...]:
    """Decays of the paper's modes in order; `recordings` names the one that shows each mode best."""
    by_name = {recording.name: recording for recording in result.recordings}
    out = []
    for number, panel in enumerate(PANELS, 1):
        recording = by_name.get(recordings.get(number, ""))
        found = None if recording is None else recording.identified
        if recording is None or found is None or found.target is None or found.target.number != number:
            continue
        compared = recording.comparison
        if isinstance(compared, DecayComparison):
            models = drawn_decays(compared)
            out.append(Decay(number, panel, recording, found, found.target, compared, models))
    return tuple(out)


def model_rows(shown: Sequence[Decay], paper: Recomputed) -> tuple[ModelRow, ...]:
    """A row for each decay and model."""
    measured = np.array(printed.TABLE_2_DAMPING_RATIO)
    printed_ratio = {"generic": np.ones(measured.size), "rayleigh": paper.equations.rayleigh_ratio / measured}
    absent = np.full(measured.size, np.nan)
    return tuple(
        ModelRow(
            decay,
            model,
            model.damping_ratio / decay.mode.damping_ratio,
            float(printed_ratio.get(model.model, absent)[decay.number - 1]),
        )
        for decay in shown
        for model in decay.models
    )


def model_errors(table: Sequence[ModelRow]) -> dict[str, list[float]]:
    """Normalised rms errors of both models in the modes that have both, and their ratios; empty without any."""
    nrmse = {(row.model.model, row.number): row.model.nrmse for row in table}
    # A model whose simulation failed has no row.
    both = [
        n for model, n in nrmse if model == "generic" and ("rayleigh", n) in nrmse and nrmse[model, n] > 0.0
    ]
    if not both:
        return {}
    generic, rayleigh = ([nrmse[model, n] for n in both] for model in ("generic", "rayleigh"))
    return {"generic": generic, "rayleigh": rayleigh, "factors": list(np.divide(rayleigh, generic))}

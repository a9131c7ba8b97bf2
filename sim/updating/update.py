"""All updates of one beam together, with the model selection."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sim.beam import BeamProperties, BuckledBeamError, NoEquilibriumError
from sim.updating.causes import ClampPosterior, PointMassPosterior, find_clamp, find_point_mass
from sim.updating.evidence import ModelComparison, compare_models
from sim.updating.least_squares import PaperUpdate, UniformUpdate, update_like_paper, update_uniform
from sim.updating.measured_modes import TUNING as MEASURED
from sim.updating.measured_modes import MeasuredModes
from sim.updating.posterior import TUNING as BAYESIAN
from sim.updating.posterior import BayesianUpdate, SmoothPrior, UndecidedError, update_bayesian
from tracker import Column, Failure, FloatArray, IntArray, data_frame, table_row

if TYPE_CHECKING:
    import pandas as pd

Method = Literal["bayesian", "clamp", "evidence", "paper", "point_mass", "uniform"]


@dataclass(frozen=True)
class Tuning:
    """The mesh of the updating."""

    #: [elements] a finer mesh is coarsened to it
    #: convention: A finer one has more unknowns, which a few modes do not determine; mode 5 is off by 8e-5, part of its
    #: sd.
    most_elements: int = 24


TUNING = Tuning()
# separates the random numbers of the discrepancy from those of the posterior draws
_STREAM = 1


@dataclass(frozen=True)
class UpdatingSettings:
    """Assumptions of the updating.

    Attributes
    ----------
    bound : float
        Largest relative change of any variable of the paper's update; twice the prior's standard deviation.
    correlation_length : float
        Of the prior's widths and thicknesses, in lengths of the beam.
    model_sd : float
        Relative standard deviation of the model error of a frequency.
    draws : int
        Of the posterior.
    point_mass : bool
        Whether to look for a point mass that the beam lacks.
    clamp : bool
        Whether to look for the stiffnesses of the clamp.
    """

    bound: float = 0.10
    correlation_length: float = 0.1
    model_sd: float = field(default_factory=lambda: MEASURED.model_sd)
    draws: int = field(default_factory=lambda: BAYESIAN.draws)
    point_mass: bool = False
    clamp: bool = False

    @property
    def prior(self) -> SmoothPrior:
        """The prior of the Bayesian update."""
        return SmoothPrior(0.5 * self.bound, self.correlation_length)


def _value(path: str) -> Callable[[tuple[Any, int]], float]:
    read = attrgetter(path)
    return lambda row: float(read(row[0])[row[1]])


def _interval(row: tuple[Updating, int]) -> FloatArray:
    updating, i = row
    return np.asarray(updating.bayesian.frequency_interval_hz()[updating.mode_numbers[i] - 1])


# Of ``updating.csv``: values of an updating and the rank of one of its measured modes.
_ONE_CHANGE = "with one change of thickness and stiffness along the whole beam"
UPDATING_COLUMNS = (
    Column("mode", "", "number of the beam's mode", lambda row: int(row[0].mode_numbers[row[1]])),
    Column("measured_hz", "Hz", "as measured, at small amplitude", _value("measured_hz")),
    Column("standard_hz", "Hz", "of the beam as configured", _value("standard_hz")),
    Column("updated_hz", "Hz", "of the most probable beam", _value("updated_hz")),
    Column("updated_q05_hz", "Hz", "5 % quantile of the posterior", lambda row: float(_interval(row)[0])),
    Column("updated_q95_hz", "Hz", "95 % quantile", lambda row: float(_interval(row)[1])),
    Column("paper_hz", "Hz", "by the paper's method, no gravity", _value("paper.updated_hz")),
    Column("uniform_hz", "Hz", _ONE_CHANGE, _value("uniform.updated_hz")),
)


@dataclass(frozen=True)
class Updating:
    """Result of updating one beam by each method; `point_mass` and `clamp` are None where none was looked for."""

    measured: MeasuredModes
    paper: PaperUpdate
    uniform: UniformUpdate
    bayesian: BayesianUpdate
    evidence: ModelComparison
    point_mass: PointMassPosterior | None = None
    clamp: ClampPosterior | None = None

    @property
    def properties(self) -> BeamProperties:
        """The most probable beam, used in simulations."""
        return self.bayesian.properties

    @property
    def mode_numbers(self) -> IntArray:
        """Measured modes, shape (m,)."""
        return self.measured.mode_numbers

    @property
    def measured_hz(self) -> FloatArray:
        """Their frequencies, shape (m,)."""
        return self.measured.frequency_hz

    @property
    def measured_sd_hz(self) -> FloatArray:
        """Standard deviations of those, shape (m,)."""
        return self.measured.sd_hz

    @property
    def standard_hz(self) -> FloatArray:
        """Of the beam as configured, gravity included, shape (m,)."""
        return self.bayesian.standard_hz

    @cached_property
    def predicted_hz(self) -> FloatArray:
        """Predictive draws of the measured frequencies of modes 1 to c, shape (n, c).

        Posterior draws for measured modes; for the others with the discrepancy between model and beam, drawn from its
        posterior, because a misspecified model is matched at the measured modes only.
        """
        draws = self.bayesian.predicted_hz
        smooth = [m for m in self.evidence.models if m.name.startswith("smooth")]
        model = max(smooth, key=lambda m: m.name.endswith("+gravity"))
        rng = np.random.default_rng((self.bayesian.seed, _STREAM))
        sd = rng.choice(model.discrepancy, size=draws.shape[0], p=model.discrepancy_weight)
        off = np.exp(sd[:, np.newaxis] * rng.standard_normal(draws.shape))
        off[:, self.measured.mode_numbers[self.measured.mode_numbers <= draws.shape[1]] - 1] = 1.0
        return np.asarray(draws * off)

    @property
    def updated_hz(self) -> FloatArray:
        """Of the most probable beam, shape (m,)."""
        return self.bayesian.updated_hz

    def rows(self) -> list[dict[str, Any]]:
        """One row per measured mode, with the columns of ``updating.csv``."""
        return [table_row(UPDATING_COLUMNS, (self, i)) for i in range(len(self.mode_numbers))]

    def to_dataframe(self) -> pd.DataFrame:
        """One row per measured mode, with the columns of ``updating.csv``."""
        return data_frame(self.rows(), UPDATING_COLUMNS)

    def plot(self, ax: Any = None) -> Any:
        """Relative error of each frequency before and after updating; returns the matplotlib Axes."""
        import matplotlib.pyplot as plt  # noqa: PLC0415

        ax = plt.figure().add_subplot() if ax is None else ax
        for label, values, marker in (
            ("configured", self.standard_hz, "s"),
            ("uniform", self.uniform.updated_hz, "^"),
            ("Bayesian", self.updated_hz, "o"),
        ):
            error = 100.0 * (values / self.measured_hz - 1.0)
            ax.plot(self.mode_numbers, error, marker, markerfacecolor="none", label=label)
        ax.axhline(0.0, color="0.5", linewidth=0.8)
        ax.set(xlabel="mode", ylabel="error of the frequency (%)", xticks=self.mode_numbers)
        ax.legend()
        return ax

    def __repr__(self) -> str:
        before, after = (
            100.0 * float(np.max(np.abs(values / self.measured_hz - 1.0)))
            for values in (self.standard_hz, self.updated_hz)
        )
        return (
            f"Updating({self.mode_numbers.size} modes: largest frequency error {before:.2g} % as configured, "
            f"{after:.2g} % updated)"
        )

    def _repr_html_(self) -> str:
        return str(self.to_dataframe().to_html(index=False))


_DEFAULT_SETTINGS = UpdatingSettings()
UpdatePart = (
    BayesianUpdate
    | ClampPosterior
    | ModelComparison
    | PaperUpdate
    | PointMassPosterior
    | UniformUpdate
    | Failure
)


def chosen_methods(settings: UpdatingSettings) -> tuple[Method, ...]:
    """Parts of `update`, those that take longest first."""
    asked: tuple[Method, ...] = ("clamp",) if settings.clamp else ()
    asked = ("point_mass", *asked) if settings.point_mass else asked
    return (*asked, "bayesian", "evidence", "paper", "uniform")


def update(
    properties: BeamProperties,
    measured: MeasuredModes,
    settings: UpdatingSettings = _DEFAULT_SETTINGS,
    *,
    modes: int | None = None,
    seed: int = 0,
) -> Updating | Failure:
    """Update a beam by all methods, with at most 24 elements.

    The settings' `model_sd` replaces that of `measured`. `modes` is the number of modes to predict; three more than the
    highest measured one when absent.

    Raises
    ------
    ValueError
        If the bound is not between 0 and 0.5.
    """
    parts = {
        method: update_by(method, properties, measured, settings, modes=modes, seed=seed)
        for method in chosen_methods(settings)
    }
    return all_updates(measured, settings, parts)


def update_by(
    method: Method,
    properties: BeamProperties,
    measured: MeasuredModes,
    settings: UpdatingSettings = _DEFAULT_SETTINGS,
    *,
    modes: int | None = None,
    seed: int = 0,
) -> UpdatePart:
    """One part of `update`, which depends on no other: a process may compute each."""
    standard, with_sd = _coarse(properties), replace(measured, model_sd=settings.model_sd)
    try:
        if method == "bayesian":
            return update_bayesian(
                standard, with_sd, prior=settings.prior, modes=modes, draws=settings.draws, seed=seed
            )
        if method == "evidence":
            return compare_models(standard, with_sd, prior=settings.prior, seed=seed)
        if method == "point_mass":
            return find_point_mass(standard, with_sd, prior=settings.prior, seed=seed)
        if method == "clamp":
            return find_clamp(standard, with_sd, prior=settings.prior, seed=seed)
        if method == "paper":
            return update_like_paper(standard, with_sd, bound=settings.bound, seed=seed)
        return update_uniform(standard, with_sd, bound=settings.bound)
    except (UndecidedError, BuckledBeamError, NoEquilibriumError) as error:
        return Failure(str(error))


def all_updates(
    measured: MeasuredModes, settings: UpdatingSettings, parts: Mapping[Method, UpdatePart]
) -> Updating | Failure:
    """The result of `update` from its parts, or the first failure of one."""
    failed = next((part for part in parts.values() if isinstance(part, Failure)), None)
    if failed is not None:
        return failed
    found: dict[Any, Any] = dict(parts)
    return Updating(measured=replace(measured, model_sd=settings.model_sd), **found)


def _coarse(properties: BeamProperties) -> BeamProperties:
    """The beam with 24 elements, or the fewest more of which each has one section, by values in their middles.

    A section that changes at every boundary of the elements given varies smoothly: 24 have that of their middles.
    """
    fine = properties.elements
    if fine <= TUNING.most_elements:
        return properties
    differ = (np.diff(properties.width_m) != 0.0) | (np.diff(properties.thickness_m) != 0.0)
    changes = 1 + np.flatnonzero(differ)
    smooth = changes.size == fine - 1
    counts = range(TUNING.most_elements, fine + 1)
    count = next(n for n in counts if smooth or not np.any(changes * n % fine))
    old, new = (np.arange(fine) + 0.5) / fine, (np.arange(count) + 0.5) / count
    return replace(
        properties,
        width_m=np.interp(new, old, properties.width_m),
        thickness_m=np.interp(new, old, properties.thickness_m),
    )

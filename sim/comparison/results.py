"""Results of a comparison."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sim.comparison.drag import DragFit, DragLimit
from sim.comparison.scores import ScoreSum
from sim.damping import DAMPING_MODELS
from tracker import INTERVAL_SD, Column, FloatArray, data_frame, table_row

if TYPE_CHECKING:
    import pandas as pd


def _of(path: str) -> Callable[[tuple[Any, Any]], Any]:
    read = attrgetter(path)
    return lambda row: read(row[1])


# Of ``comparison.csv``: values of a comparison and the decay of one of its models.
_SAME_FIT = "of the simulated decay, by the same fit"
COMPARISON_COLUMNS = (
    Column("recording", "", "name of the recording", lambda row: row[0].recording),
    Column("mode", "", "number of the beam's mode", lambda row: row[0].mode_number),
    Column("model", "", "key of the damping model", _of("model")),
    Column("damping_ratio_measured", "1", "as in `modes.csv`", lambda row: row[0].damping_ratio),
    Column("damping_ratio_simulated", "1", _SAME_FIT, _of("damping_ratio")),
    Column("frequency_measured_hz", "Hz", "as in `modes.csv`", lambda row: row[0].frequency_hz),
    Column("frequency_simulated_hz", "Hz", _SAME_FIT, _of("frequency_hz")),
    Column("nrmse", "1", "rms of simulated minus measured over rms of measured displacement", _of("nrmse")),
    Column("envelope_error", "1", "rms error of the amplitude, weighted by it", _of("envelope_error")),
    Column(
        "phase_error_rad", "rad", "rms error of the phase, weighted by the amplitude", _of("phase_error_rad")
    ),
    Column("samples", "1", "samples that the scores count", _of("log_density.samples")),
    Column("log_density", "nat", "log predictive density of the samples, in mm", _of("log_density.total")),
    Column(
        "log_density_gain",
        "nat",
        "excess of the first model (`generic`) over it",
        _of("log_density_gain.total"),
    ),
    Column("log_density_gain_se", "nat", "standard error of the gain", _of("log_density_gain.se")),
    Column("crps", "mm", "continuous ranked probability score per sample", _of("crps.mean")),
    Column("coverage_90", "1", "share of the samples within the 90 % predictive band", _of("coverage")),
)


@dataclass(frozen=True)
class ModelDecay:
    """The decay that one damping model predicts, in the unit of the comparison, with its scores.

    Attributes
    ----------
    simulated : array, shape (n, k)
    nrmse : float
        rms(simulated - measured) / rms(measured) over the samples that identification used.
    frequency_hz, damping_ratio, frequency_shift : float
        Of the target mode, from the same fit to `simulated` as to the recording, the last the relative
        shift at the initial amplitude; NaN where that failed, for the reason in `note`.
    envelope_error : float
        rms of simulated minus measured amplitude over the decay, relative to the rms of the measured one.
    phase_error_rad : float
        rms of simulated minus measured phase over the decay, weighted by the square of the amplitude.
    band_low, band_high : array or None, shape (n, k)
        5 % and 95 % quantile of the curve, from simulations with posterior draws of frequency, damping and start; None
        without draws.
    predictive_sd : array, shape (n, k)
        Standard deviation of a sample about `simulated`, from the draws, the noise of the sample, and the misfit of the
        beam's shape. NaN where nothing was measured.
    log_density, crps : ScoreSum
        Scores over the samples used, in nats and in the unit of the comparison.
    log_density_gain, crps_gain : ScoreSum
        Score of the first model of the comparison minus that of this one: positive in log density and negative in CRPS
        if the first is better.
    coverage : float
        Share of the samples used within the 90 % predictive band.
    """

    model: str
    simulated: FloatArray
    nrmse: float
    frequency_hz: float
    damping_ratio: float
    frequency_shift: float
    envelope_error: float
    phase_error_rad: float
    band_low: FloatArray | None
    band_high: FloatArray | None
    predictive_sd: FloatArray
    log_density: ScoreSum
    crps: ScoreSum
    log_density_gain: ScoreSum
    crps_gain: ScoreSum
    coverage: float
    note: str = ""

    @property
    def predictive_band(self) -> tuple[FloatArray, FloatArray]:
        """5 % and 95 % quantile of a sample."""
        reach = INTERVAL_SD * self.predictive_sd
        return self.simulated - reach, self.simulated + reach


@dataclass(frozen=True)
class DecayComparison:
    """A recorded decay, n instants and k channels, and its simulation with each damping model.

    Attributes
    ----------
    mode_number, frequency_hz, damping_ratio :
        Of the target mode, as measured.
    frequency_shift, frequency_shift_sd : float
        Measured relative frequency shift at the initial amplitude, f2 / f0; NaN where unknown.
    tip_amplitude_mm : float
        Initial amplitude of the mode at the tip, by the beam's shape.
    time_s : array, shape (n,)
        Times of the recording from the beginning of the fit on.
    measured, used : array, shape (n, k)
        Displacement without baseline, NaN where missing; samples that identification used.
    drag : DragFit, DragLimit or None
        Quadratic air drag in this recording; None where it was not requested.
    """

    recording: str
    mode_number: int
    frequency_hz: float
    damping_ratio: float
    frequency_shift: float
    frequency_shift_sd: float
    tip_amplitude_mm: float
    channels: tuple[str, ...]
    positions_mm: FloatArray
    unit: str
    time_s: FloatArray
    measured: FloatArray
    used: NDArray[np.bool_]
    models: tuple[ModelDecay, ...]
    drag: DragFit | DragLimit | None = None
    notes: tuple[str, ...] = ()

    def rows(self) -> list[dict[str, Any]]:
        """One row per damping model, with the columns of ``comparison.csv``."""
        return [table_row(COMPARISON_COLUMNS, (self, decay)) for decay in self.models]

    def to_dataframe(self) -> pd.DataFrame:
        """One row per damping model, with the columns of ``comparison.csv``."""
        return data_frame(self.rows(), COMPARISON_COLUMNS)

    def plot(self, ax: Any = None) -> Any:
        """Measured and simulated decay of the channel that moves most; returns the matplotlib Axes."""
        import matplotlib.pyplot as plt  # noqa: PLC0415

        ax = plt.figure().add_subplot() if ax is None else ax
        k = int(np.argmax(np.nanstd(self.measured, axis=0)))
        ax.plot(self.time_s, self.measured[:, k], color="0.5", linewidth=0.8, label="measured")
        for decay in self.models:
            entry = DAMPING_MODELS.get(decay.model)
            colour, label = (None, decay.model) if entry is None else (entry.colour, entry.label)
            ax.plot(self.time_s, decay.simulated[:, k], color=colour, linewidth=0.8, label=label)
        ax.set(xlabel="time (s)", ylabel=f"displacement of {self.channels[k]} ({self.unit})")
        ax.set_title(f"{self.recording}, mode {self.mode_number}")
        ax.legend()
        return ax

    def __repr__(self) -> str:
        found = ", ".join(f"{decay.model} {decay.damping_ratio:.4g}" for decay in self.models)
        return (
            f"DecayComparison({self.recording!r}, mode {self.mode_number}: damping ratio {self.damping_ratio:.4g} "
            f"measured; simulated {found})"
        )

    def _repr_html_(self) -> str:
        return str(self.to_dataframe().to_html(index=False))

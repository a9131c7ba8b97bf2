"""Results of a plan: predicted intervals, their limits, suggestions and trials."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from modalcam.planning.request import PlannedMode, PlanRequest
from tracker import FloatArray

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

# Quantile of the normal distribution: half the width of a 90 % interval in standard deviations.
NINETY = 1.645


@dataclass(frozen=True)
class Limit:
    """A cause of uncertainty, the factor by which it increases the standard deviation of damping, and a remedy."""

    cause: str
    factor: float
    advice: str


@dataclass(frozen=True)
class ModePlan:
    """Prediction for one planned recording.

    Attributes
    ----------
    planned : PlannedMode
    frequency_hz, seen_hz : float
        Of the beam's theory, and as it appears at the frame rate: different where the mode is aliased.
    decay_s : float
    amplitude_px : array, shape (m,)
        Of each marker at the start, attenuated by the exposure; signed by the shape.
    blur_px : float
        Longest motion during an exposure.
    frequency_sd_hz, damping_sd : float
        Predicted standard deviations, that of the frequency with the tolerance of the frame rate.
    limits : tuple of Limit
        Causes of these, the strongest first.
    softening : float
        Relative change of the frequency from small amplitude to the start of the decay.
    linear_tip_mm : float
        Largest tip amplitude at which that change stays within the noise; inf if the planned one is below it.
    template_factor : float
        Factor in `damping_sd` for noise in the template that the tracker learns.
    """

    planned: PlannedMode
    frequency_hz: float
    seen_hz: float
    decay_s: float
    amplitude_px: FloatArray
    blur_px: float
    frequency_sd_hz: float
    damping_sd: float
    limits: tuple[Limit, ...]
    softening: float
    template_factor: float
    linear_tip_mm: float

    @property
    def number(self) -> int:
        """Number of the mode."""
        return self.planned.number

    @property
    def damping_ratio(self) -> float:
        """Assumed damping ratio."""
        return self.planned.damping_ratio

    @property
    def nonlinear(self) -> bool:
        """Whether the shift of the frequency with amplitude exceeds the noise."""
        return bool(np.isfinite(self.linear_tip_mm))

    @property
    def largest_px(self) -> float:
        """Largest amplitude of a marker at the start."""
        return float(np.max(np.abs(self.amplitude_px)))


@dataclass(frozen=True)
class BetterPositions:
    """Marker positions for some of the planned modes, and the factors on their standard deviations."""

    modes: tuple[int, ...]
    positions_mm: tuple[float, ...]
    factors: tuple[float, ...]


@dataclass(frozen=True)
class FrameRate:
    """A frame rate for some of the planned modes, the apparent frequency of each, and whether one is aliased."""

    modes: tuple[int, ...]
    fps: float
    seen_hz: tuple[float, ...]
    aliased: bool


@dataclass(frozen=True)
class TrialSummary:
    """All rendered recordings of one mode: in how many it was identified, and the reasons of the failures, each once.

    ``damping_spread`` is the standard deviation of the damping ratio over the trials; NaN below three.
    """

    mode: int
    identified: int
    count: int
    damping_spread: float
    problems: tuple[str, ...]


@dataclass(frozen=True, repr=False)
class Plan:
    """Predicted intervals with suggestions and, where recordings were simulated, their scatter."""

    request: PlanRequest
    modes: tuple[ModePlan, ...]
    positions: tuple[BetterPositions, ...] = ()
    rates: tuple[FrameRate, ...] = ()
    trials: tuple[TrialSummary, ...] = ()

    def to_dataframe(self) -> pd.DataFrame:
        """Predictions, a row a mode; standard deviations, not half-widths of intervals."""
        import pandas as pd  # noqa: PLC0415 - slow to load

        trials = {t.mode: t for t in self.trials}
        rows = []
        for m in self.modes:
            row = {
                "mode": m.number,
                "frequency_hz": m.frequency_hz,
                "frequency_sd_hz": m.frequency_sd_hz,
                "damping_ratio": m.damping_ratio,
                "damping_ratio_sd": m.damping_sd,
                "fps": m.planned.fps,
                "decay_s": m.decay_s,
                "tip_amplitude_mm": m.planned.tip_amplitude_mm,
                "largest_amplitude_px": m.largest_px,
                "limited_by": m.limits[0].cause,
                "limit_factor": m.limits[0].factor,
            }
            if m.number in trials:
                row["identified"] = trials[m.number].identified
                row["damping_ratio_spread"] = trials[m.number].damping_spread
            rows.append(row)
        return pd.DataFrame(rows).set_index("mode")

    def plot(self, ax: Axes | None = None) -> Axes:
        """Assumed damping ratios with their predicted 90 % intervals over frequency."""
        if ax is None:
            import matplotlib.pyplot as plt  # noqa: PLC0415 - slow to load

            ax = plt.figure().subplots()
        frequency = [m.frequency_hz for m in self.modes]
        damping = [100.0 * m.damping_ratio for m in self.modes]
        half = [100.0 * NINETY * m.damping_sd for m in self.modes]
        ax.errorbar(frequency, damping, half, fmt="o", capsize=3.0)
        ax.set_xlabel("natural frequency (Hz)")
        ax.set_ylabel("damping ratio (%), predicted 90 % interval")
        return ax

    def __repr__(self) -> str:
        relative = {m.number: 100.0 * m.damping_sd / m.damping_ratio for m in self.modes}
        parts = ", ".join(f"mode {number}: ± {percent:.2g} %" for number, percent in relative.items())
        return f"<Plan: predicted sd of the damping ratio, relative; {parts}>"

    def _repr_html_(self) -> str:
        return str(self.to_dataframe().to_html(float_format="{:.5g}".format))

"""Fig. 2 to 4: each recorded decay and its simulations with the damping models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from modal_id import Identification, IdentifiedMode
from modalcam.apps.paper.recomputed import Recomputed
from modalcam.pipeline import RecordingResult, RunResult
from modalcam.report import drawn_decays, nrmse_of_fit
from sim import reference as printed
from sim.comparison import DecayComparison, ModelDecay

PANELS = ("Fig. 2, left", "Fig. 2, right", "Fig. 3, left", "Fig. 3, right", "Fig. 4")
# A model whose damping is off by less predicts it.
_NEAR = 0.05


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


class Row(NamedTuple):
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
        return abs(self.ratio - 1.0) < _NEAR

    @property
    def as_printed(self) -> bool:
        """Whether the ratio agrees with that of the paper's Table 2 within 5 %."""
        return abs(self.ratio / self.printed_ratio - 1.0) < _NEAR


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


def rows(shown: Sequence[Decay], paper: Recomputed) -> tuple[Row, ...]:
    """A row for each decay and model."""
    measured = np.array(printed.TABLE_2_DAMPING_RATIO)
    printed_ratio = {"generic": np.ones(measured.size), "rayleigh": paper.equations.rayleigh_ratio / measured}
    absent = np.full(measured.size, np.nan)
    return tuple(
        Row(
            decay,
            model,
            model.damping_ratio / decay.mode.damping_ratio,
            float(printed_ratio.get(model.model, absent)[decay.number - 1]),
        )
        for decay in shown
        for model in decay.models
    )


def errors(table: Sequence[Row]) -> dict[str, list[float]]:
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

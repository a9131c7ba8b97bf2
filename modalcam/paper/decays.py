"""Fig. 2 to 4: each recorded decay and its simulations with the damping models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from modalcam.names import shown as shown_name
from modalcam.paper.recomputed import Recomputed
from modalcam.pipeline.results import RecordingResult, RunResult
from modalcam.report.derived.signals import drawn_decays, nrmse_of_fit, shown_channel
from modalcam.report.figures.simulated import SIMULATED, simulated_shown
from modalcam.report.style.damping_models import model_label
from modalcam.report.style.svg import FigureView
from modalcam.report.style.text import sentence
from sim.comparison import DecayComparison, ModelDecay
from sim.reference import paper_tables as printed

_PANELS = ("Fig. 2, left", "Fig. 2, right", "Fig. 3, left", "Fig. 3, right", "Fig. 4")
# A model whose damping is off by less predicts it.
NEAR = 0.05


@dataclass(frozen=True)
class Decay:
    """One of the paper's panels: a recording of the mode, the identified mode, and its simulations."""

    number: int
    panel: str
    recording: RecordingResult
    found: Identification
    mode: IdentifiedMode
    models: tuple[ModelDecay, ...]


@dataclass(frozen=True)
class Row:
    """One damping model in one decay.

    Attributes
    ----------
    decay : Decay
    model : ModelDecay
    ratio : float
        Simulated over measured damping ratio.
    printed_ratio : float
        The same by the paper's Table 2; NaN for a model that the paper does not have.
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
    def name(self) -> str:
        """Name of the model at the start of a line."""
        return model_label(self.model.model)

    @property
    def identified(self) -> bool:
        """Whether a damping ratio was identified from the simulation."""
        return bool(np.isfinite(self.ratio))

    @property
    def near(self) -> bool:
        """Whether the model predicts the measured damping within 5 %."""
        return abs(self.ratio - 1.0) < NEAR

    @property
    def deviation(self) -> float:
        """Relative error of the simulated damping ratio."""
        return self.ratio - 1.0

    @property
    def in_paper(self) -> bool:
        """Whether the paper has this model."""
        return bool(np.isfinite(self.printed_ratio))

    @property
    def as_printed(self) -> bool:
        """Whether the ratio agrees with that of the paper's Table 2 within 5 %."""
        return abs(self.ratio / self.printed_ratio - 1.0) < NEAR

    @property
    def floor(self) -> float:
        """Normalised rms error of the fit of Eq. 1 itself."""
        return nrmse_of_fit(self.decay.found)


def decays(result: RunResult, recordings: dict[int, str]) -> tuple[Decay, ...]:
    """Decays of the paper's modes in order; `recordings` names the one that shows each mode best."""
    by_name = {recording.name: recording for recording in result.recordings}
    out = []
    for number, panel in enumerate(_PANELS, 1):
        recording = by_name.get(recordings.get(number, ""))
        if recording is None or not isinstance(recording.identification, Identification):
            continue
        found, compared = recording.identification, recording.comparison
        mode = found.target
        if mode is None or mode.number != number or not isinstance(compared, DecayComparison):
            continue
        out.append(Decay(number, panel, recording, found, mode, drawn_decays(compared)))
    return tuple(out)


def figures(shown: Sequence[Decay]) -> tuple[FigureView, ...]:
    """A figure for each decay, titled with the paper's panel."""
    out = []
    for decay in shown:
        channel = decay.found.series.channels[shown_channel(decay.found)]
        compared = decay.recording.comparison
        data = simulated_shown(compared, channel) if isinstance(compared, DecayComparison) else None
        view = None if data is None else SIMULATED.view(f"paper-decay-{decay.number}", data)
        if view is not None:
            title = f"{decay.panel}: mode {decay.number}, {shown_name(decay.recording.file)}"
            out.append(replace(view, title=title))
    return tuple(out)


def rows(shown: Sequence[Decay], paper: Recomputed) -> tuple[Row, ...]:
    """A row for each decay and model."""
    measured = printed.TABLE_2_DAMPING_RATIO
    printed_ratio = {
        "generic": np.ones(len(measured)),
        "rayleigh": paper.equations.rayleigh_ratio / np.array(measured),
    }
    absent = np.full(len(measured), np.nan)
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


def missing(shown: Sequence[Decay]) -> list[int]:
    """The paper's modes without a simulated decay."""
    return [n for n in range(1, len(_PANELS) + 1) if n not in {decay.number for decay in shown}]


def errors(table: Sequence[Row]) -> dict[str, list[float]]:
    """Normalised rms errors of both models in the modes that have both, and their ratios; empty without any."""
    by_mode = {
        model: {row.number: row.model.nrmse for row in table if row.model.model == model}
        for model in ("generic", "rayleigh")
    }
    # A model whose simulation failed has no row.
    both = [n for n in by_mode["generic"] if n in by_mode["rayleigh"] and by_mode["generic"][n] > 0.0]
    if not both:
        return {}
    generic, rayleigh = ([by_mode[model][n] for n in both] for model in ("generic", "rayleigh"))
    factors = [r / g for g, r in zip(generic, rayleigh, strict=True)]
    return {"generic": generic, "rayleigh": rayleigh, "factors": factors}


def notes(shown: Sequence[Decay]) -> tuple[str, ...]:
    """Notes of each simulation."""
    out = []
    for decay in shown:
        compared = decay.recording.comparison
        own = compared.notes if isinstance(compared, DecayComparison) else ()
        texts = (*own, *(f"{model_label(model.model)}: {model.note}" for model in decay.models if model.note))
        out += [f"Mode {decay.number}: {sentence(text)}" for text in texts]
    return tuple(out)

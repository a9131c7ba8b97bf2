"""Fig. 2 to 4: each recorded decay beside those simulated with generic and with Rayleigh damping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from modalcam.names import shown as shown_name
from modalcam.paper.recomputed import Recomputed
from modalcam.paper.words import largest, listed, modes_named, percent_range, signed_percent
from modalcam.pipeline.results import RecordingResult, RunResult
from modalcam.report.derived.model_decays import ModelDecay, drawn_decays, model_label
from modalcam.report.derived.signals import nrmse_of_fit, shown_channel
from modalcam.report.figures.simulated import simulated_figure
from modalcam.report.sections.scores import verdict
from modalcam.report.style.format import MISSING, fixed, interval, percent, significant
from modalcam.report.style.svg import FigureView
from modalcam.report.style.text import sentence
from sim.comparison import DecayComparison
from sim.reference import paper_tables as printed

_PRINTED_AS = ("Fig. 2, left", "Fig. 2, right", "Fig. 3, left", "Fig. 3, right", "Fig. 4")
# A model whose damping is this near to the measured one predicts it.
NEAR = 0.05


@dataclass(frozen=True)
class Decay:
    """One of the paper's panels: a recording of the mode, what was measured and what each model makes of it."""

    number: int
    panel: str
    recording: RecordingResult
    found: Identification
    mode: IdentifiedMode
    models: tuple[ModelDecay, ...]


@dataclass(frozen=True)
class Row:
    """One model in one decay; `printed_ratio` is what the model gives the paper's own Table 2."""

    panel: str
    number: int
    recording: str
    model: str
    name: str
    measured: str
    interval: str
    simulated: str
    ratio: str
    printed_ratio: str
    nrmse: str
    floor: str
    envelope: str
    coverage: str
    ratio_full: float
    nrmse_full: float
    coverage_full: float


def decays(result: RunResult, recordings: dict[int, str]) -> tuple[Decay, ...]:
    """Decays of the paper's modes in order; `recordings` names the one that shows each mode best."""
    by_name = {recording.name: recording for recording in result.recordings}
    out = []
    for number, panel in enumerate(_PRINTED_AS, 1):
        recording = by_name.get(recordings.get(number, ""))
        if recording is None or not isinstance(recording.identification, Identification):
            continue
        found, compared = recording.identification, recording.comparison
        mode = found.target
        if mode is None or mode.number != number or not isinstance(compared, DecayComparison):
            continue
        models = drawn_decays(compared, found.series.channels[shown_channel(found)])
        out.append(Decay(number, panel, recording, found, mode, models))
    return tuple(out)


def figures(shown: Sequence[Decay]) -> tuple[FigureView, ...]:
    """A figure for each decay, under the paper's own name."""
    out = []
    for decay in shown:
        series = decay.found.series
        view = simulated_figure(
            f"paper-decay-{decay.number}",
            decay.models,
            channel=series.channels[shown_channel(decay.found)],
            unit=series.unit,
            frequency_hz=decay.mode.frequency_hz,
        )
        if view is not None:
            out.append(
                replace(view, title=f"{decay.panel}: mode {decay.number}, {shown_name(decay.recording.file)}")
            )
    return tuple(out)


def rows(shown: Sequence[Decay], paper: Recomputed) -> tuple[Row, ...]:
    """A line a decay and model."""
    out = []
    for decay in shown:
        z, sd = 100.0 * decay.mode.damping_ratio, 100.0 * decay.mode.damping_ratio_sd
        low, high = decay.mode.damping_interval()
        for model in decay.models:
            ratio = model.damping_ratio / decay.mode.damping_ratio
            own = printed_ratio(model.model, decay.number, paper)
            out.append(
                Row(
                    panel=decay.panel,
                    number=decay.number,
                    recording=decay.recording.name,
                    model=model.model,
                    name=model_label(model.model),
                    measured=significant(z, 3),
                    interval=interval(100.0 * low, 100.0 * high, sd),
                    simulated=significant(100.0 * model.damping_ratio, 3),
                    ratio=fixed(ratio, 2),
                    printed_ratio=fixed(own, 2),
                    nrmse=percent(model.nrmse),
                    floor=percent(nrmse_of_fit(decay.found)),
                    envelope=percent(model.envelope_error),
                    coverage=percent(model.coverage),
                    ratio_full=ratio,
                    nrmse_full=model.nrmse,
                    coverage_full=model.coverage,
                )
            )
    return tuple(out)


def printed_ratio(model: str, number: int, paper: Recomputed) -> float:
    """Simulated over measured damping that a model has by the paper's Table 2; NaN for a model the paper has not."""
    if model == "generic":
        return 1.0
    if model == "rayleigh":
        return float(paper.equations.rayleigh_ratio[number - 1]) / printed.TABLE_2_DAMPING_RATIO[number - 1]
    return float("nan")


def sentences(table: Sequence[Row], result: RunResult, paper: Recomputed) -> tuple[str, ...]:
    """Whether the paper's finding holds here, from the numbers."""
    if not table:
        return (
            "No decay of these modes was simulated, so that there is nothing beside the paper’s figures.",
        )
    shown = sorted({row.number for row in table})
    out = []
    for model in dict.fromkeys(row.model for row in table):
        own = [row for row in table if row.model == model and np.isfinite(row.ratio_full)]
        if own:
            out.append(_of_model(own))
    absent = [n for n in range(1, len(_PRINTED_AS) + 1) if n not in shown]
    if absent:
        out.append(f"There is no simulated decay of {modes_named(absent)} in this folder.")
    return (*out, *_rayleigh(result, paper), *_errors(table), *verdict(result))


def notes(shown: Sequence[Decay]) -> tuple[str, ...]:
    """What each simulation says of itself."""
    out = []
    for decay in shown:
        compared = decay.recording.comparison
        own = compared.notes if isinstance(compared, DecayComparison) else ()
        texts = (*own, *(f"{model_label(model.model)}: {model.note}" for model in decay.models if model.note))
        out += [f"Mode {decay.number}: {sentence(text)}" for text in texts]
    return tuple(out)


def _of_model(own: Sequence[Row]) -> str:
    name, off = own[0].name, [row for row in own if abs(row.ratio_full - 1.0) >= NEAR]
    good = [row for row in own if row not in off]
    parts = []
    if good:
        within = percent(max(largest([row.ratio_full - 1.0 for row in good]), 1e-4), 1)
        parts.append(
            f"gives {modes_named([row.number for row in good])} the measured damping within {within}"
        )
    if off:
        each = listed(row.ratio for row in off)
        parts.append(f"{each} times the measured damping in {modes_named([row.number for row in off])}")
    expected = [row for row in own if row.printed_ratio != MISSING]
    agree = [row for row in expected if abs(row.ratio_full / float(row.printed_ratio) - 1.0) < NEAR]
    text = f"{name} {'gives ' if not good else ''}{' and '.join(parts)}"
    if expected and len(agree) == len(expected):
        return f"{text}, as the paper’s own Table 2 would have it."
    others = [row for row in expected if row not in agree]
    if others:
        expected_ratios = listed(row.printed_ratio for row in others)
        where = modes_named([row.number for row in others])
        text += f"; by the paper’s Table 2 it would be {expected_ratios} times in {where}"
    return text + "."


def _rayleigh(result: RunResult, paper: Recomputed) -> tuple[str, ...]:
    e, beam = paper.equations, result.beam
    ratios = listed(f"{significant(100.0 * z, 3)}" for z in e.rayleigh_ratio[2:])
    measured = listed(f"{100.0 * z:.2f}" for z in printed.TABLE_2_DAMPING_RATIO[2:])
    text = (
        f"Eq. 4 with Table 2 has α = {significant(e.alpha_1_s, 4)} 1/s and β = {significant(e.beta_s, 3)} s, "
        f"which gives modes 3 to 5 {ratios} % where Table 2 has {measured} %."
    )
    if beam is None or not np.isfinite(beam.rayleigh_alpha_1_s):
        return (text,)
    alpha, beta = beam.rayleigh_alpha_1_s, beam.rayleigh_beta_s
    return (
        (
            f"{text} These recordings have α = {significant(alpha, 4)} 1/s "
            f"({signed_percent(alpha / e.alpha_1_s - 1.0)}) and β = {significant(beta, 3)} s "
            f"({signed_percent(beta / e.beta_s - 1.0)})."
        ),
    )


def _errors(table: Sequence[Row]) -> tuple[str, ...]:
    """What is left of the recordings when the generic model has spoken, beside what the fit itself leaves."""
    by_mode = {
        model: {row.number: row.nrmse_full for row in table if row.model == model}
        for model in ("generic", "rayleigh")
    }
    # A model that failed in a recording has no row there.
    both = [n for n in by_mode["generic"] if n in by_mode["rayleigh"] and by_mode["generic"][n] > 0.0]
    if not both:
        return ()
    errors = {model: [found[n] for n in both] for model, found in by_mode.items()}
    over = [r / g for g, r in zip(errors["generic"], errors["rayleigh"], strict=True)]
    return (
        (
            f"Of the measured displacement’s rms the generic model misses {percent_range(errors['generic'])} "
            f"and the Rayleigh model {percent_range(errors['rayleigh'])}: {significant(min(over), 2)} to "
            f"{significant(max(over), 2)} times as much. What the fit of Eq. 1 itself leaves, noise included, "
            "is the floor."
        ),
    )

"""Stage of the comparison: each decay simulated with the updated beam, and scores of the models over all."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from modal_id import Identification
from modalcam.config import AirConfig
from modalcam.pipeline.beam import damping_candidates, generic_damping, measured_damping
from modalcam.pipeline.identify import measured_modes
from modalcam.pipeline.results import BeamResult, RecordingResult
from modalcam.pipeline.stage import Context, Stage, UpdatedBeam, added_stages, each_together
from modalcam.plugins import OUR_PACKAGES
from sim.beam import BeamProperties
from sim.comparison import AirDrag, DecayComparison, ModelDecay, ScoreSum, bands, compare_decay
from sim.damping import MeasuredDamping, beam_section, skipped_damping_models
from tracker import Failure


def compare_models(
    identification: Identification,
    properties: BeamProperties,
    beams: tuple[BeamProperties, ...],
    models: tuple[str, ...],
    damping: MeasuredDamping,
    air: AirConfig,
) -> DecayComparison | Failure:
    """Measured decay against each damping model, from the fitted state at the onset; `beams` are posterior draws."""
    # Workers only: the main process would hold the libraries of the fit beside all results.
    from modal_id import fit_free_decay  # noqa: PLC0415

    drag = None
    if air.drag_coefficient != 0.0:
        given = None if air.drag_coefficient == "identify" else air.drag_coefficient
        drag = AirDrag(generic_damping(properties, damping), air.density_kg_m3, given)
    return compare_decay(
        properties,
        identification,
        damping_candidates(models, properties, damping),
        # what a simulation has beside the modes it started with are harmonics and errors of its steps
        fit=partial(fit_free_decay, max_modes=len(identification.modes)),
        air=drag,
        beams=beams,
    )


COMPARING = Stage(
    "simulating",
    "comparison",
    ("sim", "modal_id", "modalcam.pipeline.beam", "modalcam.pipeline.compare", "modalcam.config.resolve"),
    compare_models,
    lambda name, reason: Failure(reason, name),
)


def compare_recordings(
    context: Context, recordings: Sequence[RecordingResult], beam: BeamResult | None
) -> tuple[list[RecordingResult], tuple[str, ...]]:
    """Compare each identified recording with simulations of the updated beam; added stages run beside.

    Sentences name skipped models and, without an updated beam, skipped stages of plugins.
    """
    added = added_stages("simulating")
    if beam is None or beam.updated is None:
        # The note on the beam tells of our own stages.
        others = [
            one.stage for one in added if one.stage.function.__module__.split(".")[0] not in OUR_PACKAGES
        ]
        return list(recordings), tuple(f"Without an updated beam, {s.name} was skipped." for s in others)
    properties, draws = beam.updated.properties, beam.updated.bayesian
    config = context.config
    material = None if config.beam is None else config.beam.material
    section = beam_section(properties, material, config.air.density_kg_m3)
    measured = measured_damping(measured_modes(recordings), beam.standard_modes)
    measured = replace(measured, section=section)
    common = {
        "properties": properties,
        "beams": draws.draws(min(bands.TUNING.draws, len(draws.log_factor_draws))),
        "models": context.config.damping.models,
        "damping": measured,
        "air": context.config.air,
    }

    def compared(recording: RecordingResult) -> Mapping[str, Any] | None:
        found = recording.identified
        # The damping ratios of a record without a decay are in `measured`.
        is_decay = found is not None and bool(found.modes) and found.has_decay
        return {"identification": found, **common} if is_decay else None

    skipped = skipped_damping_models(context.config.damping.models, measured)
    updated = UpdatedBeam(properties, measured)
    parts = [(one.stage, lambda r, inputs=one.inputs: inputs(context, r, updated)) for one in added]
    found = each_together(context, recordings, (COMPARING, compared), *parts)
    dropped = {one.stage.file for one in added}
    for recording in found:
        if not isinstance(recording.comparison, DecayComparison):
            for file in dropped:
                context.results.get(recording.name, {}).pop(file, None)
    return [
        r
        if isinstance(r.comparison, DecayComparison)
        else replace(r, added={file: value for file, value in r.added.items() if file not in dropped})
        for r in found
    ], skipped


@dataclass(frozen=True)
class ModelScore:
    """Scores of one damping model over the recordings with which it was compared.

    `log_density` and `crps` are sums over all samples, the CRPS in the unit of the comparisons; their gains say by how
    much the first model scores better on the same recordings. `coverage` is the share of the samples inside the 90 %
    predictive band.
    """

    model: str
    recordings: tuple[str, ...]
    log_density: ScoreSum
    crps: ScoreSum
    log_density_gain: ScoreSum
    crps_gain: ScoreSum
    coverage: float


def compared(recordings: Iterable[RecordingResult]) -> tuple[tuple[str, DecayComparison], ...]:
    """Comparisons with the names of their recordings."""
    return tuple((r.name, r.comparison) for r in recordings if isinstance(r.comparison, DecayComparison))


def model_scores(recordings: Iterable[RecordingResult]) -> tuple[ModelScore, ...]:
    """Scores of every model; the others are compared with the first."""
    decays: dict[str, list[tuple[str, ModelDecay]]] = {}
    for name, comparison in compared(recordings):
        for decay in comparison.models:
            decays.setdefault(decay.model, []).append((name, decay))
    return tuple(_score(model, found) for model, found in decays.items())


def _score(model: str, found: list[tuple[str, ModelDecay]]) -> ModelScore:
    only = [decay for _, decay in found]
    samples = np.array([decay.log_density.samples for decay in only], dtype=np.float64)
    inside = float(np.array([decay.coverage for decay in only]) @ samples)
    nothing = ScoreSum(0.0, 0.0, 0)
    return ModelScore(
        model=model,
        recordings=tuple(name for name, _ in found),
        log_density=sum((d.log_density for d in only), nothing),
        crps=sum((d.crps for d in only), nothing),
        log_density_gain=sum((d.log_density_gain for d in only), nothing),
        crps_gain=sum((d.crps_gain for d in only), nothing),
        coverage=inside / float(samples.sum()) if samples.sum() else float("nan"),
    )

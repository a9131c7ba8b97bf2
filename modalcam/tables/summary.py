"""`summary.json`: all results and their provenance, for other programs; `run.toml`: the configuration as resolved."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from modal_id import (
    AMPLITUDE,
    DAMPING,
    FREQUENCY,
    IDENTITY,
    SMALL_DAMPING,
    SMALL_FREQUENCY,
    Identification,
    IdentifiedMode,
)
from modal_id.modes import ALIAS_COLUMNS, find_nodes
from modalcam.common import shown
from modalcam.config import ExperimentConfig, dump_config
from modalcam.pipeline import (
    BeamResult,
    RecordingResult,
    RunResult,
    Workspace,
    aliases,
    budgets,
    model_scores,
    write_json,
    write_text,
)
from modalcam.tables.base import Output, Writer
from modalcam.tables.csv_files import (
    LAW_TABLES,
    comparison_rows,
    curvature,
    drag_rows,
    law_rows,
    updating_rows,
)
from sim.updating import Updating
from tracker import INTERVAL_ENDS, DisplacementSeries, FailedTracking, Failure, MarkerTracks, table_row


def summary(result: RunResult) -> dict[str, Any]:
    """All results as values that JSON can hold; unknown ones are None."""
    tree = {
        "program": dict(result.versions).get("modalcam", ""),
        "versions": dict(result.versions),
        "command_line": result.command_line,
        "folder": shown(result.folder),
        "seed": result.seed,
        "config": result.resolved_config,
        "recordings": [_recording(recording, result.beam) for recording in result.recordings],
        "aliases": [
            {
                "recording": line.line.recording,
                "finding": str(line),
                "frequencies": [table_row(ALIAS_COLUMNS, (line, one)) for one in line.aliases],
            }
            for line in aliases(result.recordings)
        ],
        "comparison": [row for recording in result.recordings for row in comparison_rows(recording)],
        "scores": model_scores(result.recordings),
        "drag": drag_rows(result.recordings),
        "uncertainty": budgets(result.recordings),
        "beam": result.beam and _beam(result.beam),
        "updating": updating_rows(result),
        **{table: law_rows(table, result) for table in LAW_TABLES},
        **result.added,
        "not_done": result.not_done,
    }
    return dict(jsonable(tree))


def _summary_outputs(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
    yield Output(workspace.summary, result, lambda path: write_json(path, summary(result)))


def _config_outputs(workspace: Workspace, _: RunResult, config: ExperimentConfig) -> Iterator[Output]:
    text = dump_config(config)
    yield Output(workspace.config, text, lambda path: write_text(path, text))


def _recording(recording: RecordingResult, beam: BeamResult | None) -> dict[str, Any]:
    tracks, found = recording.tracks, recording.identification
    identified = found if isinstance(found, Identification) else None
    return {
        "recording": recording.name,
        "file": shown(recording.file),
        "sha256": recording.sha256,
        "mode_asked": recording.mode,
        "failure": recording.failure,
        "proposed_px": tracks.proposed_px if isinstance(tracks, FailedTracking) else None,
        "tracking": _tracking(tracks) if isinstance(tracks, MarkerTracks) else None,
        "onset": identified and identified.onset,
        "segments": identified.segments if identified else (),
        "modes": [
            {**_mode(mode, identified.series), "curvature_at_clamp": _at_clamp(recording, mode, beam)}
            for mode in identified.modes
        ]
        if identified
        else [],
        "driven": identified.driven if identified else (),
        "failed_modes": [_fields(mode, "reason frequency_hz number target") for mode in identified.failed]
        if identified
        else [],
        "fitting_rate": identified and identified.fitting_rate,
        "notes": identified.notes if identified else (),
        "comparison_failure": "" if recording.comparison else getattr(recording.comparison, "reason", ""),
    }


def _tracking(tracks: MarkerTracks) -> dict[str, Any]:
    return {
        **_fields(tracks, "markers positions_mm time_axis scale decode notes"),
        "missing": int(np.count_nonzero(np.isnan(tracks.x_px))),
    }


def _mode(mode: IdentifiedMode, series: DisplacementSeries) -> dict[str, Any]:
    return {
        **table_row((*IDENTITY, *FREQUENCY, *DAMPING, *AMPLITUDE), mode),
        "frequency_interval_90_hz": mode.frequency_interval_hz(),
        "frequency_interval_99_hz": mode.frequency_interval_hz(0.99),
        "damping_ratio_interval_90": mode.damping_interval(),
        "damping_ratio_interval_99": mode.damping_interval(0.99),
        **table_row((*SMALL_FREQUENCY, *SMALL_DAMPING), mode),
        **_fields(mode, "shape shape_sd mac amplitude_dependence decays flags severities notes"),
        **({} if mode.participation is None else _fields(mode, "participation participation_sd")),
        "nodes": [node._asdict() for node in find_nodes(series.positions_mm, mode.shape, mode.shape_sd)],
        "sampler": _fields(
            mode.posterior,
            "r_hat ess autocorrelation_steps acceptance noise_factor errors extrapolation_frequency_hz "
            "extrapolation_damping_ratio laplace_sd seed",
        ),
    }


def _at_clamp(recording: RecordingResult, mode: IdentifiedMode, beam: BeamResult | None) -> dict[str, Any]:
    """Curvature at the clamp of a shape with a largest amplitude of 1, or the reason why it is unknown."""
    found = curvature(recording, mode, beam, np.zeros(1))
    if isinstance(found, Failure):
        return {"reason": found.reason}
    return {"value_1_m2": found.value[0], "sd_1_m2": found.sd[0], "noise_factor": found.noise_factor}


def _beam(beam: BeamResult) -> dict[str, Any]:
    return {
        "standard_hz": beam.standard_modes.frequency_hz,
        "updated_hz": beam.updated_modes and beam.updated_modes.frequency_hz,
        "updating": beam.updated and _updating(beam.updated),
        **_fields(beam, "rayleigh_alpha_1_s rayleigh_beta_s note"),
    }


def _updating(updated: Updating) -> dict[str, Any]:
    posterior = updated.bayesian
    return {
        "paper": _fields(
            updated.paper,
            "width_factor thickness_factor density_factor elastic_modulus_factor bound at_bound smallest_bound",
        ),
        "uniform": _fields(updated.uniform, "thickness_factor stiffness_factor combinations combination_sd"),
        "posterior": {
            "factor": np.exp(posterior.log_factor),
            "factor_interval_90": posterior.factor_interval(),
            "frequency_interval_90_hz": posterior.frequency_interval_hz(),
            "prediction_interval_90_hz": np.quantile(updated.predicted_hz, INTERVAL_ENDS, axis=0).T,
            **_fields(
                posterior, "prior variance_ratio information determined undetermined effective_draws seed"
            ),
        },
        "point_mass": updated.point_mass
        and {
            "most_probable": updated.point_mass.most_probable,
            "regions_90": updated.point_mass.regions(),
            "log_odds": updated.point_mass.log_odds,
        },
        "clamp": updated.clamp
        and {
            **_fields(updated.clamp, "most_probable log_odds effective_draws"),
            **dict(
                zip(
                    ("translation_interval_90_n_m", "rotation_interval_90_n_m_rad"),
                    updated.clamp.interval(),
                    strict=True,
                )
            ),
        },
        "evidence": [
            {
                "model": model.name,
                **_fields(model, "parameters log_evidence log_evidence_stated laplace_error largest_error"),
            }
            for model in updated.evidence.models
        ],
    }


def _fields(value: object, names: str) -> dict[str, Any]:
    """Attributes under their own names."""
    return {name: getattr(value, name) for name in names.split()}


def jsonable(value: Any) -> Any:
    """Values that JSON can hold: complex numbers as [real, imaginary], unknown numbers as None."""
    if isinstance(value, np.ndarray | np.generic):
        return jsonable(value.tolist())
    if is_dataclass(value) and not isinstance(value, type):
        return jsonable({field.name: getattr(value, field.name) for field in fields(value)})
    if isinstance(value, dict):
        return {key: jsonable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [jsonable(item) for item in value]
    if isinstance(value, complex):
        return jsonable([value.real, value.imag])
    if isinstance(value, Fraction):
        return float(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


SUMMARY = Writer(
    "summary",
    "summary.json",
    "all results with versions, configuration as resolved, hashes of the inputs, seeds and source of the time axis",
    _summary_outputs,
)
CONFIG = Writer("config", "run.toml", "configuration as resolved", _config_outputs)

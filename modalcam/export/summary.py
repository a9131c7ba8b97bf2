"""`summary.json`: all results and their provenance, for other programs; `run.toml`: the configuration as resolved."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from modalcam.config.schema import ExperimentConfig
from modalcam.config.toml import dump_config
from modalcam.export.base import Output, Writer
from modalcam.export.tables import comparison_rows, drag_rows, updating_rows
from modalcam.names import shown
from modalcam.pipeline.results import BeamResult, RecordingResult, RunResult
from modalcam.pipeline.scoreboard import model_scores
from modalcam.storage.atomic import write_text
from modalcam.storage.output_folder import Workspace
from sim.updating import Updating
from tracker.results import MarkerTracks


def summary(result: RunResult) -> dict[str, Any]:
    """All results as values that JSON can hold; unknown ones are None."""
    tree = {
        "program": dict(result.versions)["modalcam"],
        "versions": dict(result.versions),
        "command_line": result.command_line,
        "folder": shown(result.folder),
        "seed": result.seed,
        "config": result.resolved_config,
        "recordings": [_recording(recording) for recording in result.recordings],
        "comparison": [row for recording in result.recordings for row in comparison_rows(recording)],
        "scores": [asdict(score) for score in model_scores(result.recordings)],
        "drag": drag_rows(result.recordings),
        "beam": None if result.beam is None else _beam(result.beam),
        "updating": updating_rows(result),
        "not_done": list(result.not_done),
    }
    return dict(_jsonable(tree))


def _summary_outputs(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
    def write(path: Path) -> None:
        write_text(path, json.dumps(summary(result), indent=1, allow_nan=False) + "\n")

    yield Output(workspace.summary, result, write)


def _config_outputs(workspace: Workspace, _: RunResult, config: ExperimentConfig) -> Iterator[Output]:
    text = dump_config(config)
    yield Output(workspace.out / "run.toml", text, lambda path: write_text(path, text))


def _recording(recording: RecordingResult) -> dict[str, Any]:
    found = recording.identification
    return {
        "recording": recording.name,
        "file": shown(recording.file),
        "sha256": recording.sha256,
        "mode_asked": recording.mode,
        "failure": recording.failure,
        "tracking": _tracking(recording.tracks) if isinstance(recording.tracks, MarkerTracks) else None,
        **(_identification(found) if isinstance(found, Identification) else _NOTHING_IDENTIFIED),
        "comparison_failure": "" if recording.comparison else getattr(recording.comparison, "reason", ""),
    }


_NOTHING_IDENTIFIED: dict[str, Any] = {"onset": None, "modes": [], "failed_modes": [], "notes": []}


def _identification(found: Identification) -> dict[str, Any]:
    return {
        "onset": asdict(found.onset),
        "modes": [_mode(mode) for mode in found.modes],
        "failed_modes": [asdict(mode) for mode in found.failed],
        "notes": list(found.notes),
    }


def _tracking(tracks: MarkerTracks) -> dict[str, Any]:
    clock = tracks.time_axis
    return {
        "markers": list(tracks.markers),
        "positions_mm": tracks.positions_mm.tolist(),
        "time_axis": {
            "source": clock.source,
            "fps_recorded": None if clock.fps_recorded is None else float(clock.fps_recorded),
            "fps_container": None if clock.fps_container is None else float(clock.fps_container),
            "notes": list(clock.notes),
        },
        "scale": None if tracks.scale is None else asdict(tracks.scale),
        "decode": asdict(tracks.decode),
        "missing": int((~(tracks.x_px == tracks.x_px)).sum()),
        "notes": list(tracks.notes),
    }


def _mode(mode: IdentifiedMode) -> dict[str, Any]:
    posterior = mode.posterior
    return {
        "mode": mode.number,
        "target": mode.target,
        "frequency_hz": mode.frequency_hz,
        "frequency_sd_hz": mode.frequency_sd_hz,
        "frequency_interval_90_hz": mode.frequency_interval_hz(0.9),
        "frequency_interval_99_hz": mode.frequency_interval_hz(0.99),
        "damping_ratio": mode.damping_ratio,
        "damping_ratio_sd": mode.damping_ratio_sd,
        "damping_ratio_interval_90": mode.damping_interval(0.9),
        "damping_ratio_interval_99": mode.damping_interval(0.99),
        "amplitude": mode.amplitude,
        "amplitude_unit": mode.amplitude_unit,
        "shape": [[value.real, value.imag] for value in mode.shape.tolist()],
        "shape_sd": mode.shape_sd.tolist(),
        "mac": mode.mac,
        "amplitude_dependence": None
        if mode.amplitude_dependence is None
        else asdict(mode.amplitude_dependence),
        "sampler": {
            "r_hat": posterior.r_hat,
            "ess": posterior.ess,
            "autocorrelation_steps": posterior.autocorrelation_steps,
            "acceptance": posterior.acceptance,
            "noise_factor": posterior.noise_factor,
            "systematic_frequency_hz": posterior.systematic_frequency_hz,
            "systematic_damping_ratio": posterior.systematic_damping_ratio,
            "laplace_sd": posterior.laplace_sd,
            "seed": posterior.seed,
        },
        "flags": list(mode.flags),
        "notes": list(mode.notes),
    }


def _beam(beam: BeamResult) -> dict[str, Any]:
    return {
        "standard_hz": beam.standard_modes.frequency_hz.tolist(),
        "updated_hz": None if beam.updated_modes is None else beam.updated_modes.frequency_hz.tolist(),
        "updating": None if beam.updated is None else _updating(beam.updated),
        "rayleigh_alpha_1_s": beam.rayleigh_alpha_1_s,
        "rayleigh_beta_s": beam.rayleigh_beta_s,
        "note": beam.note,
    }


def _updating(updated: Updating) -> dict[str, Any]:
    posterior, paper, uniform = updated.bayesian, updated.paper, updated.uniform
    return {
        "paper": {
            "width_factor": paper.width_factor.tolist(),
            "thickness_factor": paper.thickness_factor.tolist(),
            "density_factor": paper.density_factor,
            "elastic_modulus_factor": paper.elastic_modulus_factor,
            "bound": paper.bound,
            "at_bound": list(paper.at_bound),
            "smallest_bound": paper.smallest_bound,
        },
        "uniform": {
            "thickness_factor": uniform.thickness_factor,
            "stiffness_factor": uniform.stiffness_factor,
            "combinations": uniform.combinations.tolist(),
            "combination_sd": uniform.combination_sd.tolist(),
        },
        "posterior": {
            "prior": asdict(posterior.prior),
            "factor": np.exp(posterior.log_factor).tolist(),
            "factor_interval_90": posterior.factor_interval().tolist(),
            "frequency_interval_90_hz": posterior.frequency_interval_hz().tolist(),
            "prediction_interval_90_hz": np.quantile(updated.predicted_hz, [0.05, 0.95], axis=0).T.tolist(),
            "variance_ratio": posterior.variance_ratio.tolist(),
            "information": posterior.information.tolist(),
            "determined": posterior.determined,
            "undetermined": posterior.undetermined,
            "effective_draws": posterior.effective_draws,
            "seed": posterior.seed,
        },
        "evidence": [
            {
                "model": model.name,
                "parameters": model.parameters,
                "log_evidence": model.log_evidence,
                "log_evidence_stated": model.log_evidence_stated,
                "laplace_error": model.laplace_error,
                "largest_error": model.largest_error,
            }
            for model in updated.evidence.models
        ],
    }


def _jsonable(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _jsonable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_jsonable(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


SUMMARY = Writer(
    "summary",
    "summary.json",
    "all results with versions, configuration as resolved, hashes of the inputs, seeds and source of the time axis",
    _summary_outputs,
)
CONFIG = Writer("config", "run.toml", "configuration as resolved", _config_outputs)

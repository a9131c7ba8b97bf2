"""All files of OUT, written from the results of a run."""

from __future__ import annotations

from modal_id.results import Identification
from modalcam.config.schema import ExperimentConfig
from modalcam.export.netcdf import write_posterior
from modalcam.export.summary import write_summary
from modalcam.export.tables import write_comparison, write_modes, write_tracks, write_updating
from modalcam.export.uff import write_uff
from modalcam.pipeline.results import RunResult
from modalcam.report.build import build_report
from modalcam.storage.atomic import write_text
from modalcam.storage.output_folder import Workspace
from tracker.results import MarkerTracks


def write_outputs(workspace: Workspace, result: RunResult, config: ExperimentConfig) -> None:
    """Write tables, posteriors, summary and report; each file is whole or not there."""
    for recording in result.recordings:
        if isinstance(recording.tracks, MarkerTracks):
            write_tracks(workspace.tracks(recording.name), recording.tracks)
        found = recording.identification
        if isinstance(found, Identification) and found.modes:
            write_posterior(workspace.posterior(recording.name), found.modes, recording.name)
        if isinstance(found, Identification):
            write_uff(workspace.universal(recording.name), found)
    write_modes(workspace.modes, result.recordings)
    write_comparison(workspace.comparison, result.recordings)
    write_updating(workspace.updating, result.beam)
    write_summary(workspace.summary, result)
    workspace.write_config(config)
    # Last: a report stands for a run that has finished.
    write_text(workspace.report, build_report(result))

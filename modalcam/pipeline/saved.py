"""Results of a finished run, read from OUT; nothing is computed and no process is started."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from modalcam.common import InputError
from modalcam.config import dump_config
from modalcam.pipeline.cache import load
from modalcam.pipeline.output_folder import RunRecord, Source, Workspace
from modalcam.pipeline.results import RUN, STAGE_FIELDS, RecordingResult, RunResult
from modalcam.pipeline.stage import ADDED_STAGES, added_stages
from modalcam.plugins import load_plugins


def measured_files() -> tuple[str, ...]:
    """Results that `simulate` starts from."""
    return ("tracks", "modes", *(added.stage.file for added in added_stages("updating")))


def load_run(out: str | Path, plugins: tuple[str, ...] = ()) -> RunResult:
    """Read a finished run; its recordings, beam and configuration are loaded when first used.

    Parameters
    ----------
    out : str or Path
        Folder of the results of `modalcam run`, `identify` or `simulate`.
    plugins : tuple of str
        Modules to load first, in addition to the plugins of installed distributions; the run needs all that it used.

    Raises
    ------
    InputError
        If OUT holds no run. A result that is missing or was saved by another version of modalcam raises it when
        `recordings` or `beam` is first used.

    Examples
    --------
    >>> import modalcam as mc
    >>> result = mc.load_run("out")  # doctest: +SKIP
    >>> result.recordings[0].identification.target  # doctest: +SKIP
    """
    load_plugins(plugins)
    workspace = Workspace(Path(out))
    state = workspace.read_state()

    def results() -> dict[str, Any]:
        record = workspace.read_record()
        return {
            "recordings": tuple(load_recording(workspace, record, source) for source in record.sources),
            "beam": _result(workspace, record, RUN, "updating"),
            "added": {f: r for f in ADDED_STAGES if (r := _result(workspace, record, RUN, f)) is not None},
            "resolved_config": dump_config(record.config),
        }

    light = {name: state[name] for name in ("folder", "versions", "command_line", "seed")}
    return RunResult.saved(results, not_done=(*state["notes"], *state["skipped"]), **light)


def load_recording(
    workspace: Workspace, record: RunRecord, source: Source, files: Iterable[str] | None = None
) -> RecordingResult:
    """One recording with its saved results, or those in `files`; InputError if one cannot be read."""
    from modal_id import Identification  # noqa: PLC0415 - heavy
    from modalcam.pipeline.track import with_displacement  # noqa: PLC0415
    from tracker import FailedTracking, Failure, MarkerTracks  # noqa: PLC0415

    if files is None:
        files = (*STAGE_FIELDS, *ADDED_STAGES)
    found: dict[str, Any] = {"tracks": None, "identification": None, "added": {}}
    for file in files:
        result = _result(workspace, record, source.name, file)
        if file in STAGE_FIELDS:
            found[STAGE_FIELDS[file]] = result
        elif result is not None:
            found["added"][file] = result
    if source.failure and found["tracks"] is None:
        found["tracks"] = FailedTracking(source.failure, source.file)
    identification = found.pop("identification")
    recording = RecordingResult(source.name, source.file, source.sha256, source.mode, **found)
    if isinstance(identification, Identification):
        return replace(recording, series=identification.series, identification=identification)
    recording = with_displacement(recording)
    if identification is None and source.failure and isinstance(recording.tracks, MarkerTracks):
        identification = Failure(source.failure, source.name)
    return recording if identification is None else replace(recording, identification=identification)


def _result(workspace: Workspace, record: RunRecord, name: str, file: str) -> Any:
    key = record.results.get(name, {}).get(file)
    if key is None:
        return None
    path = workspace.state(name, file)
    value = load(path, key)
    if value is None:
        msg = f"{path}: expected the result of the run in {workspace.out}, found none; run the same command again"
        raise InputError(msg)
    return value

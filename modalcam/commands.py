"""Commands that compute: each runs the stages it needs and writes their files.

The stages and what they import (numba, SciPy, Matplotlib, ...) are imported inside the functions that compute, so that
a run that is up to date ends at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from modalcam.config.schema import ExperimentConfig, RecordingConfig
from modalcam.config.toml import CONFIG_NAME, load_config, raw_config
from modalcam.errors import ExitCode, InputError
from modalcam.execution.dask import cluster_pool
from modalcam.execution.local import Limits
from modalcam.execution.pool import WorkerPool, worker_pool
from modalcam.execution.progress import Progress
from modalcam.inputs.discover import discover
from modalcam.names import recording_names, shown
from modalcam.pipeline.results import RecordingResult, RunResult
from modalcam.pipeline.saved import MEASURED, load_recording, load_run
from modalcam.pipeline.sources import SourceFile, hashed
from modalcam.pipeline.stage import Context
from modalcam.plugins import OUR_PACKAGES, load_plugins
from modalcam.storage.cache import Cache, digest
from modalcam.storage.output_folder import RunRecord, Source, Workspace
from modalcam.storage.outputs import Outputs
from modalcam.storage.provenance import RememberedHashes, code_state, file_sha256, stage_key

if TYPE_CHECKING:
    from modalcam.pipeline.whole import Measured


@dataclass(frozen=True)
class Options:
    """Options of the commands that compute.

    Attributes
    ----------
    out : Path
        Folder of the results.
    config : Path or None
        Configuration to use instead of ``experiment.toml`` in the folder of the recordings.
    fps : Fraction or None
        Recorded rate of all recordings, over the configuration.
    seed : int
    jobs : int
        Number of worker processes.
    force : bool
        Compute everything again.
    follow_symlinks : bool
    limits : Limits
        Of each task.
    scheduler : str or None
        Address of a Dask scheduler whose workers compute.
    plugins : tuple of str
        Modules to load beside the plugins of installed distributions.
    """

    out: Path
    config: Path | None = None
    fps: Fraction | None = None
    seed: int = 0
    jobs: int = 1
    force: bool = False
    follow_symlinks: bool = False
    limits: Limits = field(default_factory=Limits)
    scheduler: str | None = None
    plugins: tuple[str, ...] = ()

    def invocation(self, command: str) -> str:
        """The command with the options that results depend on, without paths and the number of processes."""
        rate = "" if self.fps is None else f" --fps {self.fps}"
        plugins = "".join(f" --plugin {name}" for name in self.plugins)
        return f"modalcam {command} --seed {self.seed}{rate}{plugins}"


def run(folder: Path, options: Options, progress: Progress) -> RunResult:
    """Run all stages on every recording of a folder and write OUT; what is up to date is left alone."""
    load_plugins(options.plugins)
    if not options.force and _is_up_to_date(folder, options):
        progress.say("up to date")
        return load_run(options.out)
    from modalcam.pipeline.whole import measure  # noqa: PLC0415 - heavy

    config, files, notes = _find(folder, options)
    with _context(config, options, progress, inputs=folder) as context:
        files = hashed(context, files)
        record = _record("run", folder.resolve().name, files, config, options, notes)
        key = _inputs_key(folder, options, {file.path: file.source.sha256 for file in files})
        return _finish(context, measure(context, files), record, key)


def track(target: Path, options: Options, progress: Progress) -> tuple[tuple[RecordingResult, ...], int]:
    """Track one file, or every recording of a folder, and write the tracks.

    Returns
    -------
    recordings : tuple of RecordingResult
    internal_errors : int
    """
    from modalcam.export.tables import write_tracks  # noqa: PLC0415 - heavy
    from modalcam.pipeline.whole import completed, track_sources  # noqa: PLC0415
    from tracker.results import MarkerTracks  # noqa: PLC0415

    load_plugins(options.plugins)
    single = target.is_file()
    folder = target.parent if single else target
    config, files, notes = _find(folder, options, only=target.name if single else None)
    with _context(config, options, progress, inputs=folder) as context:
        files = hashed(context, files)
        recordings = track_sources(context, files)
        for recording in recordings:
            if isinstance(recording.tracks, MarkerTracks):
                write_tracks(context.workspace.tracks(recording.name), recording.tracks)
        record = _record("track", folder.resolve().name, files, config, options, notes)
        context.workspace.write_record(completed(record, context, recordings))
        return tuple(recordings), context.pool.internal_errors


def identify(
    csv: Path, options: Options, progress: Progress, *, unit: str, recording: RecordingConfig
) -> RunResult:
    """Identify the modes of a table of displacements (of the tracker or any other) or of a universal file; write OUT.

    Parameters
    ----------
    csv : Path
    options : Options
    progress : Progress
    unit : str
        Of the channels of a table that does not state it.
    recording : RecordingConfig
        Target, onset and positions as given on the command line, which override those of the configuration file.
    """
    from modalcam.inputs.series import (  # noqa: PLC0415
        is_tracks,
        read_table,
        series_from_table,
        tracks_from_table,
    )
    from modalcam.inputs.uff import ENDINGS, read_uff  # noqa: PLC0415
    from modalcam.pipeline.whole import measure_series  # noqa: PLC0415

    load_plugins(options.plugins)
    table = None if csv.suffix.lower() in ENDINGS else read_table(csv)
    config = load_config(options.config) if options.config is not None else ExperimentConfig()
    own = next((entry for entry in config.recordings if entry.file == recording.file), None)
    if own is not None:
        recording = RecordingConfig.model_validate(own.given() | recording.given())
    config = config.model_copy(update={"recordings": (recording,)})
    result = RecordingResult(csv.stem, csv.name, file_sha256(csv), recording.mode)
    if table is None:
        positions = config.for_recording(csv.name).positions_mm
        result = replace(result, series=read_uff(csv, name=csv.stem, unit=unit, positions_mm=positions))
    elif is_tracks(table):
        known_markers = config.for_recording(csv.name)
        tracks = tracks_from_table(
            table,
            name=csv.stem,
            positions_mm=known_markers.positions_mm,
            reference=known_markers.reference or (),
        )
        result = replace(result, tracks=tracks)
    else:
        positions = config.for_recording(csv.name).positions_mm
        series = series_from_table(table, name=csv.stem, unit=unit, positions_mm=positions)
        result = replace(result, series=series)
    with _context(config, options, progress, inputs=None) as context:
        source = SourceFile(Source(result.name, result.file, result.sha256, result.mode), csv)
        record = _record("identify", csv.name, (source,), config, options, ())
        return _finish(context, measure_series(context, result), record)


@dataclass(frozen=True)
class OpenRun:
    """A finished run to start from: its record, and its recordings through identification."""

    context: Context
    record: RunRecord
    measured: Measured


@contextmanager
def opened(options: Options, progress: Progress) -> Iterator[OpenRun]:
    """Open the run in OUT to compute with its saved identification.

    A configuration in `options` replaces that of the run, for instance with other properties of the beam.

    Raises
    ------
    InputError
        If OUT holds no run, or one without a saved identification.
    """
    from modalcam.pipeline.update import beam_theory  # noqa: PLC0415 - heavy
    from modalcam.pipeline.whole import Measured  # noqa: PLC0415

    load_plugins(options.plugins)
    workspace = Workspace(options.out)
    record = workspace.read_record()
    config = record.config if options.config is None else load_config(options.config)
    record = replace(record, config=config, seed=options.seed, key="")
    with _context(config, options, progress, inputs=None) as context:
        recordings = tuple(load_recording(workspace, record, source, MEASURED) for source in record.sources)
        for recording in recordings:
            if recording.identification is None and not recording.failure:
                msg = f"{options.out}: no saved identification of {recording.name}; run again with `modalcam run`"
                raise InputError(msg)
            kept = record.results.get(recording.name, {})
            context.results[recording.name] = {name: kept[name] for name in MEASURED if name in kept}
        yield OpenRun(context, record, Measured(recordings, beam_theory(context)))


def simulate(options: Options, progress: Progress) -> RunResult:
    """Update the beam and compare again from the identification saved in OUT; see `opened`."""
    with opened(options, progress) as run_:
        return _finish(run_.context, run_.measured, run_.record)


def report(options: Options, progress: Progress) -> RunResult:
    """Write every file of OUT again that is not as its saved results would make it; nothing is computed."""
    workspace = Workspace(options.out)
    record = workspace.read_record()
    load_plugins(options.plugins)
    with workspace.locked():
        return _write_files(workspace, load_run(options.out), record.config, progress)


class Hashes(Protocol):
    """Hashes of recordings by path: a dictionary, or those of earlier runs."""

    def get(self, path: Path, /) -> str | None:
        """Hash of the recording, or None."""


class Outcome(Protocol):
    """What an exit code depends on for each recording: `RecordingResult`, for instance."""

    @property
    def failure(self) -> str:
        """Reason why there is no mode."""

    @property
    def target_failure(self) -> str:
        """Reason why the mode that was excited is missing."""


def exit_code(recordings: Iterable[Outcome], internal_errors: int) -> ExitCode:
    """Exit code after a run over `recordings`."""
    outcomes = list(recordings)
    failed = [outcome for outcome in outcomes if outcome.failure]
    if internal_errors:
        return ExitCode.INTERNAL
    if outcomes and len(failed) == len(outcomes):
        return ExitCode.NO_INPUT
    incomplete = failed or any(outcome.target_failure for outcome in outcomes)
    return ExitCode.PARTIAL if incomplete else ExitCode.OK


def _find(
    folder: Path, options: Options, only: str | None = None
) -> tuple[ExperimentConfig, tuple[SourceFile, ...], tuple[str, ...]]:
    """Configuration, recordings and notes on the folder; with `only`, that recording alone."""
    found = discover(folder, exclude=options.out, follow_symlinks=options.follow_symlinks)
    path = options.config if options.config is not None else folder / CONFIG_NAME
    wanted = options.config is not None or path.exists()
    config = load_config(path) if wanted else ExperimentConfig()
    notes = list(found.notes)
    if not wanted:
        notes.append(f"There is no {CONFIG_NAME} in the folder: only information in the recordings was used.")
    if options.fps is not None:
        config = config.with_fps(options.fps)
    present = [f for f in found.recordings if only is None or f.file == only]
    if not present:
        msg = f"{shown(only or '')}: not a recording that can be read; see `modalcam probe`"
        raise InputError(msg)
    files = [
        SourceFile(Source(f.name, f.file, "", config.for_recording(f.file).mode), f.path) for f in present
    ]
    names = {f.file for f in found.recordings}
    absent = [r for r in config.recordings if r.file not in names and only is None]
    taken = [file.source.name for file in files]
    free = recording_names([*taken, *(r.file for r in absent)])[len(taken) :]
    reason = "it is listed in the configuration but is not in the folder"
    for entry, name in zip(absent, free, strict=True):
        files.append(SourceFile(Source(name, entry.file, "", entry.mode, reason), folder / entry.file))
    return config, tuple(files), tuple(notes)


@contextmanager
def _context(
    config: ExperimentConfig, options: Options, progress: Progress, *, inputs: Path | None
) -> Iterator[Context]:
    # Workers on other machines have other working folders.
    workspace = Workspace(options.out if options.scheduler is None else options.out.absolute())
    workspace.prepare(inputs=inputs, force=options.force)
    with workspace.locked(), _pool(options, workspace, inputs, progress) as pool:
        yield Context(config, workspace, pool, progress, options.seed, options.force)


@contextmanager
def _pool(
    options: Options, workspace: Workspace, inputs: Path | None, progress: Progress
) -> Iterator[WorkerPool]:
    if options.scheduler is None:
        local = worker_pool(options.jobs, options.limits, plugins=options.plugins, announce=progress.say)
        with local as pool:
            yield pool
        return
    cluster = cluster_pool(
        options.scheduler,
        options.limits,
        out=workspace.out,
        folders=() if inputs is None else (inputs.absolute(),),
        plugins=options.plugins,
        announce=progress.say,
    )
    with cluster as pool:
        yield pool


def _record(
    command: str,
    folder: str,
    files: tuple[SourceFile, ...],
    config: ExperimentConfig,
    options: Options,
    notes: tuple[str, ...],
) -> RunRecord:
    sources = tuple(file.source for file in files)
    invocation = options.invocation(f"{command} {shown(folder)}")
    return RunRecord(folder, sources, config, options.seed, invocation, notes)


def _is_up_to_date(folder: Path, options: Options) -> bool:
    """Whether OUT holds the finished run of these inputs, and all its files as they were written."""
    workspace = Workspace(options.out)
    try:
        saved = workspace.read_state()
    except InputError:
        return False
    hashes = RememberedHashes(workspace.hashes)
    key = _inputs_key(folder, options, hashes)
    states = [workspace.state(name, file) for name, files in saved["results"].items() for file in files]
    intact = key != "" and key == saved["key"] and all(path.exists() for path in states)
    return intact and Outputs(workspace).are_intact()


def _inputs_key(folder: Path, options: Options, hashes: Hashes) -> str:
    """Hash of everything that a run depends on, the configuration as it is written; empty if a hash is not known.

    Nothing is read but the configuration: the check of a marker's kind alone would load the detectors.
    """
    found = discover(folder, exclude=options.out, follow_symlinks=options.follow_symlinks)
    sha256 = [hashes.get(recording.path) for recording in found.recordings]
    path = options.config or folder / CONFIG_NAME
    if not all(sha256):
        return ""
    return stage_key(
        "run",
        folder=folder.resolve().name,
        recordings=[(r.name, r.file, value) for r, value in zip(found.recordings, sha256, strict=True)],
        notes=found.notes,
        config=repr(raw_config(path)) if options.config is not None or path.exists() else "",
        options=(options.seed, options.fps, options.plugins),
        code=code_state(*OUR_PACKAGES),
    )


def _finish(context: Context, measured: Measured, record: RunRecord, key: str = "") -> RunResult:
    from modalcam.pipeline.whole import simulate as simulate_stages  # noqa: PLC0415 - heavy

    result, record = simulate_stages(context, measured, record)
    context.workspace.write_record(record)
    result = _write_files(context.workspace, result, context.config, context.progress, force=context.force)
    if key and not context.pool.failures:
        # Last: the key stands for a run of which every file was written.
        context.workspace.write_record(replace(record, key=key))
    return result


def _write_files(
    workspace: Workspace,
    result: RunResult,
    config: ExperimentConfig,
    progress: Progress,
    *,
    force: bool = False,
) -> RunResult:
    """Write the files of OUT that have changed, with `force` all; the result names formats that are not written."""
    from modalcam.export.base import Output  # noqa: PLC0415 - heavy
    from modalcam.export.writers import outputs, with_missing_formats  # noqa: PLC0415
    from modalcam.report.build import build_report  # noqa: PLC0415
    from modalcam.storage.atomic import write_text  # noqa: PLC0415

    figures = Cache(workspace.figures)
    if force:
        figures.drop_unused()

    def write_report(path: Path) -> None:
        write_text(path, build_report(result, figures))
        figures.drop_unused()

    result = with_missing_formats(result)
    # Last: a report stands for a run that has finished.
    files = [*outputs(workspace, result, config), Output(workspace.report, result, write_report)]
    written = Outputs(workspace, force=force)
    code = code_state(*OUR_PACKAGES)
    # Several files show the same results: each is hashed once.
    digests = {id(file.shows): digest(file.shows) for file in {id(f.shows): f for f in files}.values()}
    progress.begin("writing", len(files))
    for file in files:
        key = stage_key("file", shows=digests[id(file.shows)], code=code)
        kept = written.write(file.path, key, file.write)
        progress.advance(file.path.relative_to(workspace.out).as_posix(), reused=kept)
    written.finish(file.path for file in files)
    return result

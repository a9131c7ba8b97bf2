"""Commands that compute: each runs the stages it needs and writes their files.

The stages and what they import (numba, SciPy, Matplotlib, ...) are imported inside the functions that compute, so that
a run that is up to date ends at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from modalcam.common import InputError, recording_names, shown
from modalcam.config import (
    CONFIG_NAME,
    CameraConfig,
    ExperimentConfig,
    RecordingConfig,
    given_in,
    load_config,
    parse_recording,
    raw_config,
)
from modalcam.inputs import Discovery, Selection, discover, hashes_of_inputs
from modalcam.pipeline import (
    Cache,
    Context,
    Limits,
    Outputs,
    Progress,
    RecordingResult,
    RememberedHashes,
    RunRecord,
    RunResult,
    WorkerPool,
    Workspace,
    cluster_pool,
    code_state,
    digest,
    file_sha256,
    load_recording,
    load_run,
    measured_files,
    stage_key,
    worker_pool,
)
from modalcam.plugins import OUR_PACKAGES, load_plugins

if TYPE_CHECKING:
    from modalcam.pipeline import Measured
    from modalcam.report import Plots

_HashOf = Callable[[Path], str | None]


@dataclass(frozen=True)
class Options:
    """Options of the commands that compute.

    Attributes
    ----------
    out : Path
        Folder of the results.
    config : Path or None
        Configuration to use instead of ``experiment.toml`` in the folder of the recordings.
    camera : CameraConfig
        What is given here holds for all recordings, over the configuration.
    scheduler : str or None
        Address of a Dask scheduler whose workers compute, instead of `jobs` processes of this machine.
    plugins : tuple of str
        Modules to load in addition to the plugins of installed distributions.
    plots : {"interactive", "static"} or None
        Whether figures of the report can be zoomed; None: up to 12 recordings.
    excitation : {"free", "ambient"} or None
        What is given here holds for all recordings, over the configuration.
    """

    out: Path
    config: Path | None = None
    camera: CameraConfig = field(default_factory=CameraConfig)
    seed: int = 0
    jobs: int = 1
    force: bool = False
    follow_symlinks: bool = False
    selection: Selection = field(default_factory=Selection)
    limits: Limits = field(default_factory=Limits)
    scheduler: str | None = None
    plugins: tuple[str, ...] = ()
    plots: Plots | None = None
    excitation: Literal["free", "ambient"] | None = None

    def invocation(self, command: str) -> str:
        """The command with the options that results depend on, without paths and the number of processes."""
        given = given_in(self.camera)
        if self.excitation is not None:
            given["excitation"] = self.excitation
        camera = "".join(f" --{option} {value}" for option, value in given.items())
        chosen = (
            ("plugin", self.plugins),
            ("include", self.selection.include),
            ("exclude", self.selection.exclude),
        )
        repeated = "".join(f" --{option} {shown(value)}" for option, values in chosen for value in values)
        return f"modalcam {command} --seed {self.seed}{camera}{repeated}"


def run(target: Path, options: Options, progress: Progress) -> RunResult:
    """Run all stages on one file, or every recording of a folder, and write OUT; what is up to date is kept."""
    load_plugins(options.plugins)
    folder, only = _folder_of(target)
    # Before the configuration is read: one that is edited during the run must not pass for the one that was used.
    key = _inputs_key(folder, options, only)
    if not options.force and _is_up_to_date(options.out, key):
        progress.note("up to date")
        return load_run(options.out)
    from modalcam.pipeline import duplicates, hashed  # noqa: PLC0415 - heavy

    config, recordings, notes = _find(folder, options, only)
    name = only or folder.resolve().name
    with _context(config, options, progress, inputs=folder, target=name) as context:
        recordings = hashed(context, recordings, meanwhile=_load_stages())
        from modalcam.inputs import with_recorded_input  # noqa: PLC0415
        from modalcam.pipeline import (  # noqa: PLC0415
            compile_for,
            measure,
        )

        compile_for(context, recordings)
        record = _record(context, options, "run", name, (*notes, *duplicates(recordings)))
        hashes = {r.path: r.sha256 for r in recordings}
        measured = measure(context, recordings, partial(with_recorded_input, config))
        return _finish(context, options, measured, record, key(hashes.get))


def track(target: Path, options: Options, progress: Progress) -> tuple[list[RecordingResult], int]:
    """Track one file, or every recording of a folder, and write the tracks; the number counts internal errors."""
    from modalcam.pipeline import (  # noqa: PLC0415
        compile_for,
        completed,
        duplicates,
        hashed,
        track_recordings,
    )
    from modalcam.tables import write_tracks  # noqa: PLC0415 - heavy
    from tracker import MarkerTracks  # noqa: PLC0415

    load_plugins(options.plugins)
    folder, only = _folder_of(target)
    config, recordings, notes = _find(folder, options, only)
    name = only or folder.resolve().name
    with _context(config, options, progress, inputs=folder, target=name) as context:
        recordings = hashed(context, recordings)
        compile_for(context, recordings, tracking_only=True)
        recordings = track_recordings(context, recordings)
        for recording in recordings:
            if isinstance(recording.tracks, MarkerTracks):
                write_tracks(context.workspace.tracks(recording.name), recording.tracks)
        record = _record(context, options, "track", name, (*notes, *duplicates(recordings)))
        for note in record.notes:
            progress.note(f"note: {note}")
        context.workspace.write_record(completed(record, context, recordings))
        return recordings, context.pool.internal_errors


def identify(
    path: Path,
    options: Options,
    progress: Progress,
    *,
    unit: str,
    rate_hz: float | None = None,
    recording: RecordingConfig,
    known_input: str | None = None,
    input_unit: str | None = None,
    input_file: Path | None = None,
) -> RunResult:
    """Identify the modes of a table of displacements (of the tracker or any other) or of a universal file; write OUT.

    `unit` is that of the channels of a table that does not state it, `rate_hz` the samples per second of one without
    times; `recording` holds target and onset of the command line, which override those of the configuration file.
    `known_input` names the channel that drives the others; with an `input_unit` other than theirs it is a force.
    `input_file` is another table that holds it, at times of its own.
    """
    from modalcam.inputs import motion_of, with_input_file, with_known_input  # noqa: PLC0415
    from modalcam.pipeline import (  # noqa: PLC0415
        compile_for,
        measure,
    )
    from tracker import displacement_series  # noqa: PLC0415

    load_plugins(options.plugins)
    given_options = {"unit": unit, "rate": rate_hz, "input": known_input, "input-unit": input_unit}
    given_options["input-file"] = None if input_file is None else input_file.name
    given_options |= {
        name.replace("_", "-"): one for name, one in recording.given().items() if name != "file"
    }
    config = load_config(options.config) if options.config is not None else ExperimentConfig()
    entry_of_config = next((entry for entry in config.recordings if entry.file == recording.file), None)
    if entry_of_config is not None:
        where = f"{options.config} with the options of the command line"
        recording = parse_recording(entry_of_config.given() | recording.given(), where=where)
    config = config.model_copy(update={"recordings": (recording,)})
    given, name = config.for_recording(path.name), recording_names([path.name])[0]
    motion = motion_of(path, name, given, options.limits, unit=unit, rate_hz=rate_hz)
    if input_file is not None:
        series = motion["series"] if "series" in motion else displacement_series(motion["tracks"])
        motion["series"] = with_input_file(series, input_file, known_input, input_unit or "N")
    elif known_input is not None:
        motion = with_known_input(motion, known_input, input_unit)
    for note in motion["series"].notes if "series" in motion else ():
        progress.note(f"note: {note}")
    result = RecordingResult(name, path.name, file_sha256(path), recording.mode, **motion)
    with _context(config, options, progress, inputs=None, target=path.name) as context:
        compile_for(context, [result])
        record = _record(context, options, "identify", path.name, given=given_options)
        return _finish(context, options, measure(context, [result]), record)


@contextmanager
def opened(options: Options, progress: Progress) -> Iterator[tuple[Context, RunRecord, Measured]]:
    """Open the run in OUT to compute with its saved identification: its record, and its recordings so far.

    A configuration in `options` replaces that of the run, for instance with other properties of the beam. InputError
    if OUT holds no run, or one without a saved identification.
    """
    from modalcam.pipeline import (  # noqa: PLC0415
        Measured,
        beam_theory,
    )

    load_plugins(options.plugins)
    workspace = Workspace(options.out)
    record = workspace.read_record()
    config = record.config if options.config is None else load_config(options.config)
    record = replace(record, config=config, seed=options.seed, key="")
    with _context(config, options, progress, inputs=None) as context:
        recordings = tuple(
            load_recording(workspace, record, source, measured_files()) for source in record.sources
        )
        for recording in recordings:
            if recording.identification is None and not recording.failure:
                msg = f"{options.out}: no saved identification of {recording.name}; run again with `modalcam run`"
                raise InputError(msg)
            kept = record.results.get(recording.name, {})
            context.results[recording.name] = {name: kept[name] for name in measured_files() if name in kept}
        yield context, record, Measured(recordings, beam_theory(context))


def simulate(options: Options, progress: Progress) -> RunResult:
    """Update the beam and compare again from the identification saved in OUT; see `opened`."""
    with opened(options, progress) as (context, record, measured):
        return _finish(context, options, measured, record)


def report(options: Options, progress: Progress) -> RunResult:
    """Rewrite every file of OUT that differs from what its saved results would give; nothing is computed."""
    load_plugins(options.plugins)
    workspace = Workspace(options.out)
    record = workspace.read_record()
    with workspace.locked():
        return _write_files(workspace, load_run(options.out), record.config, progress, options)


def _load_stages() -> Iterator[str]:
    """Import what the stages need in steps of a few tenths of a second, while worker processes start."""
    for name in ("scipy.special", "numba", "modalcam.pipeline.all_stages"):
        yield import_module(name).__name__


def _folder_of(target: Path) -> tuple[Path, str | None]:
    """Folder of recordings to search, and the only file wanted in it."""
    return (target.parent, target.name) if target.is_file() else (target, None)


def _discovered(folder: Path, options: Options, only: str | None) -> Discovery:
    """What the folder holds, or what is selected of it; a recording that is named needs no selection."""
    found = discover(folder, exclude=options.out, follow_symlinks=options.follow_symlinks)
    return found if only is not None else options.selection.of(found)


def _find(
    folder: Path, options: Options, only: str | None
) -> tuple[ExperimentConfig, list[RecordingResult], tuple[str, ...]]:
    """Configuration, recordings and notes on the folder; with `only`, that recording alone."""
    from tracker import FailedTracking  # noqa: PLC0415 - heavy

    found = _discovered(folder, options, only)
    path = options.config if options.config is not None else folder / CONFIG_NAME
    has_config = options.config is not None or path.exists()
    config = load_config(path) if has_config else ExperimentConfig()
    notes = list(found.notes)
    if not has_config:
        notes.append(f"There is no {CONFIG_NAME} in the folder: only information in the recordings was used.")
    fps = options.camera.fps
    other = [
        f"{shown(r.file)} ({r.fps})" for r in config.recordings if None not in (fps, r.fps) and r.fps != fps
    ]
    if other:
        notes.append(f"--fps {fps} replaces the rates that the configuration gives: {', '.join(other)}.")
    config = config.with_camera(options.camera)
    left_out = [r.file for r in config.recordings if r.leave_out] if only is None else []
    present = [f for f in found.recordings if f.file == only or (only is None and f.file not in left_out)]
    if left_out and not present:
        msg = "the configuration leaves out every recording of the folder; remove leave_out of one"
        raise InputError(msg)
    if left_out:
        notes.append(f"Left out by the configuration: {', '.join(map(shown, left_out))}.")
    if not present:
        msg = f"{shown(only or '')}: not a recording that can be read; see `modalcam probe`"
        raise InputError(msg)
    if options.excitation is not None:
        config = config.with_excitation(options.excitation, [f.file for f in present])
    recordings = [
        RecordingResult(f.name, f.file, "", config.for_recording(f.file).mode, path=f.path) for f in present
    ]
    if only is None:
        names = {f.file for f in found.recordings}
        reason = "it is listed in the configuration but is not in the folder"
        expected = [r.file for r in config.recordings if not r.leave_out and options.selection.takes(r.file)]
        absent = [(file, reason) for file in expected if file not in names]
        absent += [one for one in found.unreadable if one[0] not in {*dict(absent), *left_out}]
        taken = [recording.name for recording in recordings]
        free = recording_names([*taken, *(file for file, _ in absent)])[len(taken) :]
        recordings += [
            RecordingResult(name, file, "", config.for_recording(file).mode, tracks=FailedTracking(why, file))
            for name, (file, why) in zip(free, absent, strict=True)
        ]
    return config, recordings, tuple(notes)


@contextmanager
def _context(
    config: ExperimentConfig,
    options: Options,
    progress: Progress,
    *,
    inputs: Path | None,
    target: str | None = None,
) -> Iterator[Context]:
    # Workers on other machines have other working folders.
    workspace = Workspace(options.out if options.scheduler is None else options.out.absolute())
    workspace.prepare(inputs=inputs, target=target, force=options.force)
    if options.scheduler is None:
        opening = worker_pool(options.jobs, options.limits, plugins=options.plugins, announce=progress.say)
    else:
        opening = cluster_pool(
            options.scheduler,
            options.limits,
            out=workspace.out,
            folders=() if inputs is None else (inputs.absolute(),),
            plugins=options.plugins,
            announce=progress.say,
        )
    with workspace.locked(), opening as pool:
        yield Context(config, workspace, pool, progress, options.seed, options.force)


def _record(
    context: Context,
    options: Options,
    command: str,
    target: str,
    notes: tuple[str, ...] = (),
    given: Mapping[str, object] | None = None,
) -> RunRecord:
    more = "".join(
        f" --{option}" + ("" if value is True else f" {shown(str(value))}")
        for option, value in (given or {}).items()
        if value is not None and value is not False
    )
    invocation = options.invocation(f"{command} {shown(target)}{more}")
    return RunRecord(target, (), context.config, options.seed, invocation, notes)


def _is_up_to_date(out: Path, key: Callable[[_HashOf], str]) -> bool:
    """Whether OUT contains the finished run of the inputs with this key, with all its files unchanged."""
    workspace = Workspace(out)
    try:
        saved = workspace.read_state()
    except InputError:
        return False
    states = [workspace.state(name, file) for name, files in saved["results"].items() for file in files]
    found = key(RememberedHashes(workspace.hashes).get)
    intact = found != "" and found == saved["key"] and all(path.exists() for path in states)
    return intact and Outputs(workspace).are_intact()


def _inputs_key(folder: Path, options: Options, only: str | None) -> Callable[[_HashOf], str]:
    """Hash of everything that a run depends on, from a function of the recordings' hashes; empty if one is not known.

    Folder and configuration, which is not parsed, are read at once. Nothing else is read: the check of a marker's kind
    alone would load the detectors.
    """
    found = _discovered(folder, options, only)
    wanted = [recording for recording in found.recordings if only is None or recording.file == only]
    path = options.config or folder / CONFIG_NAME
    raw = raw_config(path) if options.config is not None or path.exists() else {}
    config = repr((raw, hashes_of_inputs(folder, raw)))

    def key(hash_of: _HashOf) -> str:
        sha256 = [hash_of(recording.path) for recording in wanted]
        if not wanted or not all(sha256):
            return ""
        return stage_key(
            "run",
            target=only or folder.resolve().name,
            recordings=[(r.name, r.file, value) for r, value in zip(wanted, sha256, strict=True)],
            notes=(found.notes, found.unreadable),
            config=config,
            options=(options.seed, options.camera, options.excitation, options.plugins, options.plots),
            code=code_state(*OUR_PACKAGES),
        )

    return key


def _finish(
    ctx: Context, options: Options, measured: Measured, record: RunRecord, key: str = ""
) -> RunResult:
    from modalcam.pipeline import simulate as simulate_stages  # noqa: PLC0415 - heavy

    result, record = simulate_stages(ctx, measured, record)
    ctx.workspace.write_record(record)
    result = _write_files(ctx.workspace, result, ctx.config, ctx.progress, options, ctx.pool)
    if key and not ctx.pool.failures:
        # Last: the key means that every file of the run was written.
        ctx.workspace.write_record(replace(record, key=key))
    return result


def _write_files(
    workspace: Workspace,
    result: RunResult,
    config: ExperimentConfig,
    progress: Progress,
    options: Options,
    pool: WorkerPool | None = None,
) -> RunResult:
    """Write the files of OUT that have changed, with `force` all; the result names formats that are not written.

    Figures are drawn by the processes of `pool` where there is one, while this process writes the files without them.
    """
    from modalcam.pipeline import write_text  # noqa: PLC0415
    from modalcam.report import (  # noqa: PLC0415
        build_report,
        compiled_templates,
        draw_figures,
    )
    from modalcam.tables import Output, outputs, with_missing_formats  # noqa: PLC0415

    figures = Cache(workspace.figures)
    if options.force:
        figures.drop_unused()

    def write_report(path: Path) -> None:
        write_text(path, build_report(result, figures, options.plots, contents))
        figures.drop_unused()

    result = with_missing_formats(result)
    others = list(outputs(workspace, result, config))
    contents = [(file.path.relative_to(workspace.out).as_posix(), file.about) for file in others]
    # Last: the presence of a report means that the run has finished.
    files = [*others, Output(workspace.report, result, write_report)]
    written = Outputs(workspace, force=options.force)
    code = code_state(*OUR_PACKAGES)
    # Several files show the same results: each is hashed once.
    digests = {id(file.shows): digest(file.shows) for file in {id(f.shows): f for f in files}.values()}
    kept: list[bool] = []

    def write_each() -> Iterator[Output]:
        for file in files:
            page = (options.plots, contents) if file.path == workspace.report else None
            key = stage_key("file", shows=digests[id(file.shows)], code=code, page=page)
            kept.append(written.write(file.path, key, file.write))
            yield file

    writing = write_each()
    if pool is not None:
        meanwhile = chain(islice(writing, len(others)), compiled_templates())
        draw_figures(result, workspace.figures, pool, progress, meanwhile)
    progress.begin("writing", len(files))
    for at, file in enumerate(files):
        if at == len(kept):
            next(writing)
        progress.advance(file.path.relative_to(workspace.out).as_posix(), reused=kept[at])
    written.finish(file.path for file in files)
    return result

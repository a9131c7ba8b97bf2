"""``modalcam run``, its first steps ``track`` and ``identify``, and ``simulate`` and ``report`` on saved results."""

from __future__ import annotations

import glob
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from modalcam.cli.options import (
    CONFIG_HELP,
    PIPELINE,
    SELECTION,
    Json,
    NamedOut,
    Quiet,
    Strict,
    ToldProgress,
    Verbose,
    compute,
    console,
    results_folder,
    run_options,
    takes,
)
from modalcam.common import ModalcamError, check_new, readable_bytes, shown

SavedRun = Annotated[Path, typer.Argument(help="Folder of an earlier run.")]


Targets = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE...|FOLDER", help="Recordings of one folder, or it, with or without experiment.toml."
    ),
]


def _together(targets: list[Path], common: dict[str, Any]) -> Path:
    """The recording or folder; several recordings are their folder, of which they alone are wanted."""
    folder = targets[0].parent
    if len(targets) == 1:
        return targets[0]
    for target in targets:
        if target.parent != folder or not target.is_file():
            msg = f"{shown(str(target))}: not a recording of the folder {folder}; give recordings of one folder, or it"
            raise ModalcamError(msg)
    common["include"] = [*(common["include"] or ()), *(glob.escape(target.name) for target in targets)]
    return folder


ForExcitation = Annotated[
    Literal["free", "ambient"] | None,
    typer.Option("--excitation", metavar="KIND", help="free (decays) or ambient."),
]


@takes(*PIPELINE, *SELECTION)
def run(
    targets: Targets,
    common: dict[str, Any],
    out: NamedOut = None,
    json_: Json = False,
    verbose: Verbose = 0,
    quiet: Quiet = False,
    strict: Strict = False,
    progress: ToldProgress = "text",
    excitation: ForExcitation = None,
) -> None:
    """Track, identify, simulate and report a recording or a folder."""
    from modalcam import commands

    target = _together(targets, common)
    options = run_options(out or results_folder(target), excitation=excitation, **common)
    command = partial(commands.run, target)
    compute(command, options, verbose, as_json=json_, quiet=quiet, strict=strict, progress=progress)


@takes(
    "config",
    "fps",
    "jobs",
    "scheduler",
    "time_limit",
    "memory_limit",
    "plugins",
    "force",
    "follow_symlinks",
    *SELECTION,
)
def track(
    targets: Targets,
    common: dict[str, Any],
    out: NamedOut = None,
    preview: Annotated[
        Path | None, typer.Option("--preview", help="Also write a video of FILE with the tracks drawn in.")
    ] = None,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Track the markers only and write OUT/tracks."""
    from modalcam import commands
    from modalcam.console import listener, tracked
    from modalcam.tables import check_preview, write_preview
    from tracker import MarkerTracks

    target = _together(targets, common)
    out = out or results_folder(target)
    if preview is not None:
        check_preview(preview, target, out)
        check_new(preview, force=common["force"])
    options = run_options(out, **common)
    with listener(console(), -1 if quiet else verbose) as progress:
        recordings, internal_errors = commands.track(target, options, progress)
    if preview is not None and isinstance(recordings[0].tracks, MarkerTracks):
        write_preview(preview, target, recordings[0].tracks)
    raise typer.Exit(tracked(console(), recordings, out, internal_errors, quiet=quiet))


@takes("config", "seed", "force", "plugins")
def identify(
    file: Annotated[
        Path, typer.Argument(help="Tracks file, .uff, or table (.csv .xlsx .npy .mat .lvm .tdms .h5 .nc).")
    ],
    common: dict[str, Any],
    out: NamedOut = None,
    mode: Annotated[
        int | None, typer.Option(min=1, metavar="N", help=f"{CONFIG_HELP}recordings.mode")
    ] = None,
    frequency: Annotated[
        float | None,
        typer.Option(
            "--target-hz", min=0.0, metavar="HZ", help=f"{CONFIG_HELP}recordings.target_frequency_hz"
        ),
    ] = None,
    onset: Annotated[
        float | None, typer.Option("--onset-s", min=0.0, metavar="S", help=f"{CONFIG_HELP}recordings.onset_s")
    ] = None,
    end: Annotated[
        float | None, typer.Option("--end-s", min=0.0, metavar="S", help=f"{CONFIG_HELP}recordings.end_s")
    ] = None,
    excitation: ForExcitation = None,
    unit: Annotated[str, typer.Option(help="Unit of channels without one.")] = "1",
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate", min=1e-9, max=1e12, metavar="HZ", help="Samples per second, if without times."
        ),
    ] = None,
    known_input: Annotated[
        str | None, typer.Option("--input", metavar="COLUMN", help="Channel of the base motion or force.")
    ] = None,
    input_file: Annotated[
        Path | None, typer.Option("--input-file", metavar="FILE", help="Another table that holds the input.")
    ] = None,
    output_only: Annotated[bool, typer.Option("--output-only", help="Ignore the input.")] = False,
    input_unit: Annotated[str | None, typer.Option("--input-unit", help="Unit of a force as input.")] = None,
    input_lag: Annotated[
        str | None, typer.Option("--input-lag-ms", metavar="MS", help="By which the input is late, or auto.")
    ] = None,
    json_: Json = False,
    verbose: Verbose = 0,
    quiet: Quiet = False,
    strict: Strict = False,
) -> None:
    """Identify modes from a table of motion: .csv, .mat, .uff, ..."""
    from modalcam import commands
    from modalcam.config import parse_recording
    from modalcam.inputs import MAX_BYTES, checked_unit

    checked_unit(unit, "--unit")
    if input_unit is not None:
        checked_unit(input_unit, "--input-unit")
    if mode is not None and frequency is not None:
        msg = "give either --mode or --target-hz, not both"
        raise ModalcamError(msg)
    readable_bytes(file, MAX_BYTES)
    given: dict[str, Any] = {
        "file": file.name,
        "mode": mode,
        "target_frequency_hz": frequency,
        "onset_s": onset,
        "end_s": end,
    }
    if excitation is not None:
        given["excitation"] = excitation
    if output_only:
        given["output_only"] = True
    if input_lag is not None:
        given["input_lag_ms"] = input_lag
    recording = parse_recording(given, where="command line")
    command = partial(
        commands.identify,
        file,
        unit=unit,
        rate_hz=rate,
        recording=recording,
        known_input=known_input,
        input_unit=input_unit,
        input_file=input_file,
    )
    options = run_options(out or results_folder(file), jobs=1, **common)
    compute(command, options, verbose, as_json=json_, quiet=quiet, strict=strict)


@takes("config", "seed", "jobs", "scheduler", "time_limit", "memory_limit", "plugins", "plots")
def simulate(
    out: SavedRun,
    common: dict[str, Any],
    json_: Json = False,
    verbose: Verbose = 0,
    quiet: Quiet = False,
    strict: Strict = False,
) -> None:
    """Repeat the updating of the beam and the comparison of damping."""
    from modalcam import commands

    options = run_options(out, **common)
    compute(commands.simulate, options, verbose, as_json=json_, quiet=quiet, strict=strict)


@takes("plugins", "plots")
def report(out: SavedRun, common: dict[str, Any], json_: Json = False, verbose: Verbose = 0) -> None:
    """Rewrite the report and the other files of OUT."""
    from modalcam import commands

    compute(commands.report, run_options(out, **common), verbose, as_json=json_)

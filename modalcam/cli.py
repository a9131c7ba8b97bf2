"""Command line of modalcam. Heavy imports stay inside the commands: ``--help`` answers at once."""

from __future__ import annotations

import os
import signal
import sys
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from modalcam import __version__
from modalcam.errors import ExitCode, ModalcamError

if TYPE_CHECKING:
    from modalcam.run import Options

app = typer.Typer(
    name="modalcam",
    help="Natural frequencies and damping ratios of a thin beam from high-speed recordings, "
    "with honest uncertainty, and an ANCF comparison.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

Out = Annotated[Path, typer.Option("-o", "--out", help="Folder for the results.")]
Config = Annotated[
    Path | None, typer.Option("-c", "--config", help="Configuration instead of the one found.")
]
Fps = Annotated[
    str | None,
    typer.Option("--fps", help="Recorded rate in frames per second, over everything else: 1000, 30000/1001."),
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of all random numbers.")]
Jobs = Annotated[
    int | None, typer.Option("--jobs", min=1, help="Worker processes; default: one per processor.")
]
Force = Annotated[bool, typer.Option("--force", help="Compute everything anew.")]
Links = Annotated[bool, typer.Option("--follow-symlinks", help="Also read recordings behind links.")]
Json = Annotated[bool, typer.Option("--json", help="Print a summary for programs on standard output.")]
Verbose = Annotated[int, typer.Option("-v", "--verbose", count=True, help="Say more.")]


def _version(value: bool) -> None:
    if value:
        typer.echo(f"modalcam {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    _: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command()
def run(
    folder: Annotated[Path, typer.Argument(help="Folder of recordings, with or without experiment.toml.")],
    out: Out,
    config: Config = None,
    fps: Fps = None,
    seed: Seed = 0,
    jobs: Jobs = None,
    force: Force = False,
    follow_symlinks: Links = False,
    json_: Json = False,
    verbose: Verbose = 0,
) -> None:
    """Track, identify, simulate and report every recording of FOLDER."""
    from modalcam import run as commands
    from modalcam.console import finish, listener

    options = _options(out, config, fps, seed, jobs, force, follow_symlinks)
    with listener(_console(), verbose) as progress:
        result = commands.run(folder, options, progress)
    finish(_console(), result, out, as_json=json_)
    raise typer.Exit(commands.exit_code(result.recordings, result.internal_errors))


@app.command()
def track(
    target: Annotated[
        Path, typer.Argument(metavar="FILE|FOLDER", help="Recording, or folder of recordings.")
    ],
    out: Out,
    config: Config = None,
    fps: Fps = None,
    jobs: Jobs = None,
    force: Force = False,
    follow_symlinks: Links = False,
    preview: Annotated[
        Path | None, typer.Option("--preview", help="Also write FILE's footage with the tracks drawn in.")
    ] = None,
    verbose: Verbose = 0,
) -> None:
    """Only follow the markers: writes OUT/tracks."""
    from modalcam import run as commands
    from modalcam.console import listener, tracked
    from modalcam.preview import check_preview, write_preview
    from tracker.series import MarkerTracks

    if preview is not None:
        check_preview(preview, target, out)
    options = _options(out, config, fps, 0, jobs, force, follow_symlinks)
    with listener(_console(), verbose) as progress:
        recordings, internal_errors = commands.track(target, options, progress)
    if preview is not None and isinstance(recordings[0].tracks, MarkerTracks):
        write_preview(preview, target, recordings[0].tracks)
    tracked(_console(), recordings, out)
    raise typer.Exit(commands.exit_code(recordings, internal_errors))


@app.command()
def identify(
    csv: Annotated[Path, typer.Argument(help="A tracks file, any CSV of time_s and channels, or a .uff.")],
    out: Out,
    config: Config = None,
    mode: Annotated[int | None, typer.Option(min=1, help="Mode that was excited.")] = None,
    frequency: Annotated[
        float | None, typer.Option("--target-hz", min=0.0, help="Frequency of the mode wanted.")
    ] = None,
    onset: Annotated[
        float | None, typer.Option("--onset-s", min=0.0, help="Start of the free decay.")
    ] = None,
    unit: Annotated[str, typer.Option(help="Unit of the channels of a plain CSV.")] = "1",
    seed: Seed = 0,
    force: Force = False,
    json_: Json = False,
    verbose: Verbose = 0,
) -> None:
    """Identify modes from a table of displacements, accelerations or any motion."""
    from modalcam import run as commands
    from modalcam.config import RecordingConfig
    from modalcam.console import finish, listener

    if mode is not None and frequency is not None:
        msg = "give either --mode or --target-hz, not both"
        raise ModalcamError(msg)
    recording = RecordingConfig(file=csv.name, mode=mode, target_frequency_hz=frequency, onset_s=onset)
    options = _options(out, config, None, seed, 1, force, follow_symlinks=False)
    with listener(_console(), verbose) as progress:
        result = commands.identify(csv, options, progress, unit=unit, recording=recording)
    finish(_console(), result, out, as_json=json_)
    raise typer.Exit(commands.exit_code(result.recordings, result.internal_errors))


@app.command()
def simulate(
    out: Annotated[Path, typer.Argument(help="Folder of an earlier run.")],
    config: Config = None,
    seed: Seed = 0,
    jobs: Jobs = None,
    json_: Json = False,
    verbose: Verbose = 0,
) -> None:
    """Match the beam and compare damping models again from the modes saved in OUT."""
    from modalcam import run as commands
    from modalcam.console import finish, listener

    options = _options(out, config, None, seed, jobs, force=False, follow_symlinks=False)
    with listener(_console(), verbose) as progress:
        result = commands.simulate(options, progress)
    finish(_console(), result, out, as_json=json_)
    raise typer.Exit(commands.exit_code(result.recordings, result.internal_errors))


@app.command()
def report(
    out: Annotated[Path, typer.Argument(help="Folder of an earlier run.")],
    jobs: Jobs = None,
    json_: Json = False,
    verbose: Verbose = 0,
) -> None:
    """Write the files of OUT, report.html above all, again from its saved results."""
    from modalcam import run as commands
    from modalcam.console import finish, listener

    options = _options(out, None, None, 0, jobs, force=False, follow_symlinks=False)
    with listener(_console(), verbose) as progress:
        result = commands.report(options, progress)
    finish(_console(), result, out, as_json=json_)
    raise typer.Exit(commands.exit_code(result.recordings, result.internal_errors))


@app.command()
def demo(
    out: Annotated[Path, typer.Argument(help="Folder for the footage and the results.")],
    modes: Annotated[str, typer.Option(help="Modes to film, separated by commas.")] = "2,3",
    seed: Seed = 0,
    jobs: Jobs = None,
    verbose: Verbose = 0,
) -> None:
    """Film a simulated beam and take the footage through everything."""
    from modalcam import run as commands
    from modalcam.console import finish, listener
    from modalcam.filming import film_demo

    with listener(_console(), verbose) as progress:
        folder = film_demo(out / "videos", _mode_list(modes), seed, progress)
        options = _options(out / "results", None, None, seed, jobs, force=False, follow_symlinks=False)
        result = commands.run(folder, options, progress)
    finish(_console(), result, out / "results", as_json=False)
    raise typer.Exit(commands.exit_code(result.recordings, result.internal_errors))


@app.command()
def render(
    config: Annotated[
        Path, typer.Argument(help="experiment.toml with its sections beam, camera and markers.")
    ],
    out: Out,
    mode: Annotated[int, typer.Option(min=1, help="Mode to shake.")] = 1,
    tip_amplitude_mm: Annotated[float, typer.Option(min=0.0, help="Steady amplitude of the tip.")] = 1.0,
    damping_ratio: Annotated[
        float, typer.Option(min=0.0, max=0.5, help="Damping ratio of every mode.")
    ] = 0.003,
    shake_s: Annotated[float, typer.Option(min=0.0, help="Steady shaking before the stop.")] = 0.5,
    decay_s: Annotated[float, typer.Option(min=0.0, help="Free decay after the stop.")] = 3.0,
    seed: Seed = 0,
    verbose: Verbose = 0,
) -> None:
    """Film a simulated beam as the camera of the configuration would see it."""
    from modalcam.console import listener
    from modalcam.filming import Shot, film_config

    shot = Shot(mode, tip_amplitude_mm * 1e-3, damping_ratio, shake_s, decay_s)
    with listener(_console(), verbose) as progress:
        film_config(config, out, shot, seed, progress)
    typer.echo(str(out))


@app.command()
def plan(
    config: Annotated[
        Path, typer.Argument(help="experiment.toml with beam, camera and markers; [plan] says what is meant.")
    ],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="HTML file to write as well.")] = None,
    simulate: Annotated[
        int, typer.Option(min=0, help="Render and identify each mode so many times, to see what comes out.")
    ] = 0,
    seed: Seed = 0,
    jobs: Jobs = None,
    verbose: Verbose = 0,
) -> None:
    """Predict the intervals that an experiment would give, before it is filmed."""
    from modalcam.atomic import write_text
    from modalcam.console import listener
    from modalcam.plan.make import make_plan
    from modalcam.plan.page import plan_html, show

    with listener(_console(), verbose) as progress:
        made = make_plan(
            config, trials=simulate, seed=seed, jobs=jobs or os.cpu_count() or 1, progress=progress
        )
    show(made, Console(width=None if sys.stdout.isatty() else 160))
    if out is not None:
        write_text(out, plan_html(made))
        typer.echo(str(out))


@app.command()
def init(
    folder: Annotated[Path, typer.Argument(help="Folder of recordings.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="File to write; default: standard output.")
    ] = None,
) -> None:
    """Write an experiment.toml with every option explained and what the recordings tell."""
    from modalcam.template import starter_config

    text = starter_config(folder)
    if out is None:
        typer.echo(text, nl=False)
        return
    from modalcam.atomic import write_text

    if out.exists():
        msg = f"{out}: exists already; give another file with -o"
        raise ModalcamError(msg)
    write_text(out, text)


@app.command()
def probe(
    folder: Annotated[
        Path, typer.Argument(metavar="FILE|FOLDER", help="Recording, or folder of recordings.")
    ],
    follow_symlinks: Links = False,
    json_: Json = False,
) -> None:
    """Tell what the recordings are, without tracking them."""
    from modalcam.probing import probe_folder, show_probes

    probes = probe_folder(folder, follow_symlinks=follow_symlinks)
    show_probes(probes, Console(), as_json=json_)
    raise typer.Exit(ExitCode.OK if all(p.problem == "" for p in probes) else ExitCode.PARTIAL)


@app.command(name="check-config")
def check_config(
    config: Annotated[Path, typer.Argument(help="An experiment.toml.")],
) -> None:
    """Check a configuration and print it as resolved."""
    from modalcam.config_file import dump_config, load_config

    typer.echo(dump_config(load_config(config)), nl=False)


@app.command()
def info() -> None:
    """Print versions and what this machine offers, for a bug report."""
    from modalcam.provenance import opencv_wheels, versions

    for name, version in versions():
        typer.echo(f"{name} {version}")
    typer.echo(f"processors {os.cpu_count()}")
    wheels = opencv_wheels()
    if len(wheels) > 1:
        typer.echo(
            f"warning: several OpenCV packages are installed ({', '.join(wheels)}); keep one", err=True
        )


@app.command()
def markers(
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write: .svg, or .pdf for any number.")],
    ids: Annotated[str, typer.Option(help="ArUco ids, such as 0-5,8.")] = "0-9",
    dots: Annotated[int | None, typer.Option(min=1, help="So many round dots instead of ArUco.")] = None,
    size_mm: Annotated[float, typer.Option(help="Side of the black square, or diameter of a dot.")] = 20.0,
    dictionary: Annotated[str, typer.Option(help="OpenCV's ArUco dictionary.")] = "DICT_4X4_50",
    quiet_mm: Annotated[
        float | None, typer.Option(help="White border; default: 1.5 cells, or half a dot.")
    ] = None,
    page: Annotated[str, typer.Option(help="Paper: a4 or letter.")] = "a4",
    board: Annotated[
        str | None, typer.Option(help="A ChArUco board for calibrate instead, squares across x down: 7x5.")
    ] = None,
    square_mm: Annotated[float, typer.Option(help="Side of a square of the board.")] = 30.0,
    marker_mm: Annotated[float, typer.Option(help="Side of a marker of the board.")] = 22.0,
) -> None:
    """Write a sheet of markers, or a board for the lens, to print at true scale with a ruler."""
    from modalcam.board_sheet import board_page
    from modalcam.calibrate import parse_squares
    from modalcam.markers_sheet import (
        aruco_request,
        dots_request,
        marker_pages,
        paper_name,
        parse_ids,
        write_sheet,
    )
    from tracker.camera.charuco import Board

    paper = paper_name(page)
    if board is not None:
        across, down = parse_squares(board, "--board")
        chart = Board(across, down, square_mm, marker_mm, dictionary)
        write_sheet(out, (board_page(chart, paper),))
        typer.echo(str(out))
        return
    if dots is None:
        request = aruco_request(parse_ids(ids), size_mm, dictionary, quiet_mm, paper)
    else:
        request = dots_request(dots, size_mm, quiet_mm, paper)
    write_sheet(out, marker_pages(request))
    typer.echo(str(out))


@app.command()
def calibrate(
    folder: Annotated[Path, typer.Argument(help="Folder of pictures of a ChArUco board.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write, such as camera.toml.")],
    squares: Annotated[str, typer.Option(help="Squares of the board, across x down.")] = "7x5",
    square_mm: Annotated[float, typer.Option(help="Side of a square.")] = 30.0,
    marker_mm: Annotated[float, typer.Option(help="Side of a marker.")] = 22.0,
    dictionary: Annotated[str, typer.Option(help="OpenCV's ArUco dictionary.")] = "DICT_4X4_50",
) -> None:
    """Find the lens distortion from pictures of a ChArUco board, as `modalcam markers --board` prints it."""
    from modalcam.calibrate import calibrate_folder, lines, parse_squares, write_lens
    from tracker.camera.charuco import Board

    across, down = parse_squares(squares)
    found = calibrate_folder(folder, Board(across, down, square_mm, marker_mm, dictionary))
    write_lens(out, found)
    for line in lines(found):
        typer.echo(line)


def main() -> None:
    """Entry point: expected errors become one line and an exit code, an interrupt leaves OUT resumable."""
    # To be asked to end is to be interrupted: what has begun is saved.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        app()
    except ModalcamError as error:
        _console().print(
            f"modalcam: {error}", style="bold red", markup=False, highlight=False, soft_wrap=True
        )
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        _console().print("modalcam: interrupted; run the same command again to go on", markup=False)
        sys.exit(ExitCode.INTERRUPTED)
    except BrokenPipeError:
        # The reader of standard output has gone (`| head`): nothing more to say, and no traceback at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(ExitCode.OK)


def _console() -> Console:
    # A log has no width of its own: nothing in it may be cut.
    return Console(stderr=True, width=None if sys.stderr.isatty() else 160)


def _options(
    out: Path,
    config: Path | None,
    fps: str | None,
    seed: int,
    jobs: int | None,
    force: bool,
    follow_symlinks: bool,
) -> Options:
    from modalcam.run import Options

    return Options(
        out=out,
        config=config,
        fps=_fps(fps),
        seed=seed,
        jobs=jobs or os.cpu_count() or 1,
        force=force,
        follow_symlinks=follow_symlinks,
    )


def _fps(text: str | None) -> Fraction | None:
    from modalcam.config import parse_fps

    if text is None:
        return None
    try:
        return parse_fps(text)
    except ValueError as error:
        msg = f"--fps: {error}"
        raise ModalcamError(msg) from None


def _mode_list(text: str) -> tuple[int, ...]:
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and 1 <= int(part) <= 5 for part in parts):
        msg = f"--modes: expected mode numbers from 1 to 5 separated by commas, found {text!r}"
        raise ModalcamError(msg)
    return tuple(sorted({int(part) for part in parts}))

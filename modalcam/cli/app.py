"""The application and its entry point, with the commands that are no run: ``probe``, ``init``, ``verify``, ..."""

from __future__ import annotations

import errno
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modalcam import __version__
from modalcam.cli.options import (
    COMMANDS,
    Command,
    Json,
    Links,
    Replace,
    ToFile,
    console,
    register_command,
    results_console,
)
from modalcam.cli.run import identify, report, run, simulate, track
from modalcam.common import (
    ConfigError,
    ExitCode,
    ModalcamError,
    check_new,
    for_terminal,
    shown,
    silence_readers,
)
from modalcam.pipeline import SINGLE_THREAD, return_large_arrays
from modalcam.plugins import load_apps, load_entry_points

if TYPE_CHECKING:
    from modalcam.inputs import Probe


def probe(
    folder: Annotated[
        Path, typer.Argument(metavar="FILE|FOLDER", help="Recording, or folder of recordings.")
    ],
    follow_symlinks: Links = False,
    json_: Json = False,
) -> None:
    """Show frame rate, size, markers and problems of recordings."""
    import json
    from dataclasses import asdict

    from modalcam.inputs import probe_folder
    from modalcam.pipeline import worker_pool

    # In another process: a recording may be made to need any time or memory.
    with worker_pool(1) as pool:
        probes = probe_folder(folder, follow_symlinks=follow_symlinks, each=pool.map)
    if json_:
        typer.echo(json.dumps([asdict(p) for p in probes], indent=1))
    else:
        _show(probes)
    raise typer.Exit(ExitCode.OK if all(p.problem == "" for p in probes) else ExitCode.PARTIAL)


def _show(probes: tuple[Probe, ...]) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.table import Column, Table
    from rich.text import Text

    out = results_console()
    # Folded, never cut.
    widths = {
        "recording": 15,
        "codec": 8,
        "size / px": 9,
        "bits": 4,
        "frames": 6,
        "fps in file": 7,
        "fps recorded": 8,
    }
    heads = [Column(head, overflow="fold", min_width=width) for head, width in widths.items()]
    table = Table(*heads, box=SIMPLE_HEAD, pad_edge=False)
    for p in probes:
        declared = "" if p.frames_declared in (0, p.packets) else f" of {p.frames_declared}"
        recorded = "?" if p.fps_recorded is None else f"{p.fps_recorded:g}"
        in_file = "" if p.fps_container is None else f"{p.fps_container:g}"
        bits, frames = str(p.bit_depth or ""), f"{p.packets}{declared}"
        cells = (shown(p.file), p.codec, p.size_px, bits, frames, in_file, recorded)
        table.add_row(*map(Text, cells))
    out.print(table)
    for p in probes:
        uneven = f"time stamps differ by {p.time_steps} ticks." if ", " in p.time_steps else ""
        markers = () if p.seen is None else p.seen.sentences()
        for sentence in filter(None, (uneven, *p.notes, p.problem, *markers)):
            out.print(Text(f"{shown(p.file)}: {shown(sentence)}"))


def init(
    folder: Annotated[Path, typer.Argument(help="Folder of recordings.")],
    out: ToFile = None,
    force: Replace = False,
) -> None:
    """Write a commented experiment.toml for a folder of recordings."""
    from modalcam.inputs import starter_config
    from modalcam.pipeline import worker_pool

    with worker_pool(1) as pool:
        text = starter_config(folder, each=pool.map)
    if out is None:
        typer.echo(text, nl=False)
        return
    from modalcam.pipeline import write_text

    check_new(out, force=force)
    write_text(out, text)


def check_config(config: Annotated[Path, typer.Argument(help="An experiment.toml.")]) -> None:
    """Check a configuration and print it as modalcam reads it."""
    from modalcam.config import dump_config, load_config, unusable_recordings

    read = load_config(config)
    typer.echo(dump_config(read), nl=False)
    if unusable := unusable_recordings(read):
        msg = f"{shown(str(config))}: {'; '.join(unusable)}"
        raise ConfigError(msg)


def figures(
    out: Annotated[Path, typer.Argument(help="Folder of an earlier run.")],
    to: Annotated[Path, typer.Option("-o", "--out", help="Folder for the figures.")],
    columns: Annotated[
        int,
        typer.Option(
            min=1, max=2, help="Style of a journal: letters and width for 1 column (89 mm) or 2 (183 mm)."
        ),
    ] = 2,
    force: Replace = False,
) -> None:
    """Write the figures of the report as SVG and PDF, with data."""
    check_new(to / "captions.txt", force=force)
    from modalcam.pipeline import load_run
    from modalcam.report import write_figures

    written = write_figures(load_run(out), to, columns=columns)
    typer.echo(f"{len(written)} files in {shown(str(to))}")


def verify(
    out: Annotated[Path, typer.Argument(help="Folder of results.")],
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="[FOLDER]", help="Folder of the recordings, to compare them, too."),
    ] = None,
) -> None:
    """Compare OUT, and the recordings, with the hashes of the run."""
    from modalcam.pipeline import changed_files, changed_recordings

    number, changes = changed_files(out)
    if folder is not None:
        more, others = changed_recordings(out, folder)
        number, changes = number + more, [*changes, *others]
    for change in changes:
        typer.echo(for_terminal(change))
    typer.echo(f"{number - len(changes)} of {number} files are those of the run")
    raise typer.Exit(ExitCode.PARTIAL if changes else ExitCode.OK)


def info() -> None:
    """Print versions, system, processor and BLAS, for a bug report."""
    import platform

    from modalcam.pipeline import opencv_wheels, processor, versions

    for name, version in (*versions(), ("system", platform.platform()), *processor()):
        typer.echo(f"{name} {version}")
    typer.echo(f"processors {os.cpu_count()}")
    wheels = opencv_wheels()
    if len(wheels) > 1:
        typer.echo(
            f"warning: several OpenCV packages are installed ({', '.join(wheels)}); keep one", err=True
        )


# What the system says of a medium without space, such as that of the compiled kernels, and of a name; what to do.
_REMEDIES = dict.fromkeys(
    (errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "free some space and run the same command again"
) | {errno.ENAMETOOLONG: "give a shorter name"}
# Letters that are shown of such a name: half a line of a terminal.
_LONGEST_PLACE = 40

app = typer.Typer(
    name="modalcam",
    # one line, so that the commands fit a screen of 40 lines
    help="Natural frequencies and damping ratios of a beam, with calibrated intervals.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)


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


for _command in (run, track, identify, simulate, report):
    register_command(_command, "Commands")
for _command in (init, probe, check_config):
    register_command(_command, "Before a run")
for _command in (figures, verify):
    register_command(_command)
register_command(info, "Without recordings")
load_apps("cli")
load_entry_points("modalcam.commands")
for _name, (_function, _heading) in COMMANDS.items():
    app.command(_name, cls=Command, rich_help_panel=_heading)(_function)


def main() -> None:
    """Entry point: an expected error ends in one line and an exit code; an interrupted run can be resumed."""
    # A request to terminate is treated as an interrupt: finished results are saved.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    # Before NumPy loads: in matrices as small as ours, further threads of BLAS wait for each other more than they work.
    os.environ.update(dict.fromkeys(SINGLE_THREAD, "1"))
    silence_readers()
    return_large_arrays()
    try:
        app()
    except ModalcamError as error:
        text = for_terminal(f"modalcam: {error}")
        console().print(text, style="bold red", markup=False, highlight=False, soft_wrap=True)
        sys.exit(error.exit_code)
    except (KeyboardInterrupt, SystemExit) as end:
        # typer itself ends an interrupted command, without a message
        if isinstance(end, SystemExit) and end.code != ExitCode.INTERRUPTED:
            raise
        # What is left is to end; a further interrupt would only show a traceback.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        console().print("modalcam: interrupted; run the same command again to continue", markup=False)
        sys.exit(ExitCode.INTERRUPTED)
    except MemoryError:
        console().print(
            "modalcam: the input needs more memory than this machine has; the file may be damaged",
            style="bold red",
        )
        sys.exit(ExitCode.USAGE)
    except OSError as error:
        if error.errno not in _REMEDIES:
            raise
        place = (
            f"{shown(str(error.filename))[:_LONGEST_PLACE]}: " if error.errno == errno.ENAMETOOLONG else ""
        )
        text = f"modalcam: {place}{error.strerror}: {_REMEDIES[error.errno]}"
        console().print(text, style="bold red", markup=False, highlight=False)
        sys.exit(ExitCode.USAGE)

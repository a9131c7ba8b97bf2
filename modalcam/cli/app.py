"""The application and its entry point."""

from __future__ import annotations

import errno
import os
import signal
import sys
from typing import Annotated

import typer

from modalcam import __version__
from modalcam.cli.compare import compare
from modalcam.cli.figures import figures
from modalcam.cli.options import Command, console
from modalcam.cli.paper import paper
from modalcam.cli.plan import plan
from modalcam.cli.preview import preview
from modalcam.cli.probe import probe
from modalcam.cli.render import demo, render
from modalcam.cli.run import identify, report, run, simulate, track
from modalcam.cli.setup import check_config, info, init, verify
from modalcam.cli.studio import pick, studio
from modalcam.cli.targets import calibrate, markers
from modalcam.errors import ExitCode, ModalcamError
from modalcam.execution import SINGLE_THREAD, return_large_arrays
from modalcam.files import silence_readers
from modalcam.names import for_terminal, shown

# What the system says of a medium without space, such as that of the compiled kernels, and of a name; what to do.
_REMEDIES = dict.fromkeys(
    (errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "free some space and run the same command again"
) | {errno.ENAMETOOLONG: "give a shorter name"}
# Letters that are shown of such a name: half a line of a terminal.
_LONGEST_PLACE = 40

app = typer.Typer(
    name="modalcam",
    help="Natural frequencies and damping ratios of a thin beam from high-speed recordings, "
    "with calibrated uncertainty and a comparison with ANCF simulations.",
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


# In the order in which --help lists them.
for _commands in (
    (run, studio, track, identify, simulate, report, figures, compare, verify),
    (demo, render, preview, plan, paper),
    (init, probe, pick, check_config, info, markers, calibrate),
):
    for _command in _commands:
        app.command(cls=Command)(_command)


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

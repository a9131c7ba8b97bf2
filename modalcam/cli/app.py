"""The application and its entry point."""

from __future__ import annotations

import os
import signal
import sys
from typing import Annotated

import typer

from modalcam import __version__
from modalcam.cli.calibrate import calibrate
from modalcam.cli.check_config import check_config
from modalcam.cli.demo import demo
from modalcam.cli.identify import identify
from modalcam.cli.info import info
from modalcam.cli.init import init
from modalcam.cli.markers import markers
from modalcam.cli.options import console
from modalcam.cli.paper import paper
from modalcam.cli.plan import plan
from modalcam.cli.probe import probe
from modalcam.cli.render import render
from modalcam.cli.report import report
from modalcam.cli.run import run
from modalcam.cli.simulate import simulate
from modalcam.cli.track import track
from modalcam.errors import ExitCode, ModalcamError

app = typer.Typer(
    name="modalcam",
    help="Natural frequencies and damping ratios of a thin beam from high-speed recordings, "
    "with honest uncertainty, and an ANCF comparison.",
    no_args_is_help=True,
    add_completion=False,
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


# in the order in which --help lists them
for _command in (
    run,
    track,
    identify,
    simulate,
    report,
    demo,
    render,
    plan,
    paper,
    init,
    probe,
    check_config,
    info,
    markers,
    calibrate,
):
    app.command()(_command)


def main() -> None:
    """Entry point: expected errors become one line and an exit code, an interrupt leaves OUT resumable."""
    # To be asked to end is to be interrupted: what has begun is saved.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        app()
    except ModalcamError as error:
        console().print(f"modalcam: {error}", style="bold red", markup=False, highlight=False, soft_wrap=True)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        console().print("modalcam: interrupted; run the same command again to go on", markup=False)
        sys.exit(ExitCode.INTERRUPTED)
    except BrokenPipeError:
        # The reader of standard output has gone (`| head`): nothing more to say, and no traceback at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(ExitCode.OK)

"""Options that several commands share."""

from __future__ import annotations

import os
import sys
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer
from rich.console import Console

from modalcam.errors import ModalcamError
from modalcam.execution.local import Limits

if TYPE_CHECKING:
    from modalcam.commands import Options
    from modalcam.pipeline.results import RunResult

TIME_LIMIT_S = Limits().seconds

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
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler", help="Dask scheduler (tcp://HOST:8786) whose workers do the work, not this machine."
    ),
]
TimeLimit = Annotated[
    float,
    typer.Option("--time-limit", min=1.0, help="Seconds after which a stage of a recording is stopped."),
]
MemoryLimit = Annotated[
    float | None,
    typer.Option(
        "--memory-limit", min=0.5, help="GB that a worker process may take; default: the machine's."
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Compute everything anew.")]
Links = Annotated[bool, typer.Option("--follow-symlinks", help="Also read recordings behind links.")]
Json = Annotated[bool, typer.Option("--json", help="Print a summary for programs on standard output.")]
Verbose = Annotated[int, typer.Option("-v", "--verbose", count=True, help="Say more.")]


def console() -> Console:
    """Where messages go: standard error."""
    # A log has no width of its own: nothing in it may be cut.
    return Console(stderr=True, width=None if sys.stderr.isatty() else 160)


def run_options(
    out: Path,
    *,
    config: Path | None = None,
    fps: str | None = None,
    seed: int = 0,
    jobs: int | None = None,
    force: bool = False,
    follow_symlinks: bool = False,
    scheduler: str | None = None,
    time_limit_s: float = TIME_LIMIT_S,
    memory_limit_gb: float | None = None,
) -> Options:
    """What the commands that run the pipeline were asked for."""
    from modalcam.commands import Options

    memory_bytes = None if memory_limit_gb is None else round(1e9 * memory_limit_gb)
    return Options(
        out=out,
        config=config,
        fps=_fps(fps),
        seed=seed,
        jobs=jobs or os.cpu_count() or 1,
        force=force,
        follow_symlinks=follow_symlinks,
        limits=Limits(time_limit_s, memory_bytes),
        scheduler=scheduler,
    )


def conclude(result: RunResult, out: Path, *, as_json: bool = False) -> NoReturn:
    """Show what came out and end with the exit code that says it."""
    from modalcam.commands import exit_code
    from modalcam.console import finish

    finish(console(), result, out, as_json=as_json)
    raise typer.Exit(exit_code(result.recordings, result.internal_errors))


def _fps(text: str | None) -> Fraction | None:
    from tracker.options import parse_fps

    if text is None:
        return None
    try:
        return parse_fps(text)
    except ValueError as error:
        msg = f"--fps: {error}"
        raise ModalcamError(msg) from None

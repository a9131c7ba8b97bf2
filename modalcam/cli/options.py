"""What commands share: how one is registered, common options, and their conversion to the options of a run."""

from __future__ import annotations

import functools
import inspect
import os
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer
from typer.core import TyperCommand

from modalcam.common import ExitCode, InputError, ModalcamError, real
from modalcam.pipeline import Limits, low_memory_limits

if TYPE_CHECKING:
    from rich.console import Console

    from modalcam.commands import Options
    from modalcam.pipeline import Progress, RunResult

# Headings in the help of the program, in its order.
Heading = Literal["Commands", "Before a run", "Results of a run", "Without recordings"]
# Function and heading by name, in the order of --help.
COMMANDS: dict[str, tuple[Callable[..., None], Heading]] = {}


def register_command(function: Callable[..., None], heading: Heading = "Results of a run") -> None:
    """Add a command: a function as typer takes it, whose name and docstring are those of the command.

    ``check_config`` becomes ``check-config``. The name must be new; ValueError otherwise.
    """
    name = function.__name__.replace("_", "-")
    if COMMANDS.setdefault(name, (function, heading))[0] is not function:
        msg = f"a command named {name!r} is registered already; choose another name"
        raise ValueError(msg)


class Command(TyperCommand):
    """Command that fills in the help of options which mirror the configuration, when it is shown.

    Where the reader of standard output has closed it (`| head`), it ends quietly, with the exit code of a program that
    SIGPIPE ends: what it was to say may have been that something failed.
    """

    def invoke(self, ctx: Any) -> Any:
        """Run the command, unless the memory it may use is too small for its libraries, which would end anywhere."""
        if low := low_memory_limits():
            raise InputError(low)
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            # What is still buffered is written when Python ends.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(ExitCode.CLOSED_OUTPUT) from None

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help."""
        for parameter in self.params:
            key = str(getattr(parameter, "help", ""))
            if key.startswith(CONFIG_HELP):
                from modalcam.config import option

                vars(parameter)["help"] = option(key.removeprefix(CONFIG_HELP)).short_help
        super().format_help(ctx, formatter)


# Help of an option that mirrors a key of the configuration is made from the key's field.
CONFIG_HELP = "config:"

Out = Annotated[Path, typer.Option("-o", "--out", help="Folder for the results.")]
NamedOut = Annotated[Path | None, typer.Option("-o", "--out", help="Results; default: folder NAME-results.")]
ToFile = Annotated[Path | None, typer.Option("-o", "--out", help="File to write; default: standard output.")]
Seed = Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Seed of all random numbers.")]
Jobs = Annotated[
    int | None,
    typer.Option("--jobs", min=1, metavar="N", help="Worker processes; default: one per processor."),
]
Links = Annotated[
    bool, typer.Option("--follow-symlinks", help="Also read recordings through symbolic links.")
]
Json = Annotated[bool, typer.Option("--json", help="Print a summary as JSON.")]
Verbose = Annotated[int, typer.Option("-v", "--verbose", count=True, help="More detailed output.")]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Only failures and warnings.")]
ProgressFormat = Literal["text", "json"]
ToldProgress = Annotated[ProgressFormat, typer.Option("--progress", help="Format on standard error.")]
Strict = Annotated[bool, typer.Option("--strict", help="Exit with 4 also where a value may be wrong.")]
Force = Annotated[bool, typer.Option("--force", help="Recompute everything.")]
Replace = Annotated[bool, typer.Option("--force", help="Replace a file that exists.")]
Fps = Annotated[str | None, typer.Option("--fps", help=f"{CONFIG_HELP}camera.fps")]
_CONFIG = typer.Option("-c", "--config", help="Configuration; default: experiment.toml of the folder.")
_SCHEDULER = typer.Option(
    "--scheduler", metavar="URL", help="Dask scheduler of the workers to use: tcp://HOST:8786."
)
_TIME = typer.Option(
    "--time-limit", min=1.0, max=1e7, metavar="S", help="Longest time for one stage of one recording."
)
_MEMORY = typer.Option(
    "--memory-limit",
    min=0.5,
    max=1e5,
    metavar="GB",
    help="Memory of a worker process; default: the machine's memory.",
)
_PLUGIN = typer.Option(
    "--plugin", metavar="MODULE", help="Python module that extends modalcam; may be repeated."
)

_INCLUDE = typer.Option(
    "--include", metavar="PATTERN", help="Only recordings such as mode?.avi; may be repeated."
)
_EXCLUDE = typer.Option("--exclude", metavar="PATTERN", help="All recordings but these; may be repeated.")
_PLOTS = typer.Option("--plots", help="Whether figures zoom; default: up to 12 recordings.")

# Common options by the name of their parameter: type and default.
COMMON: dict[str, tuple[Any, Any]] = {
    "config": (Annotated[Path | None, _CONFIG], None),
    "fps": (Fps, None),
    "seed": (Seed, 0),
    "jobs": (Jobs, None),
    "scheduler": (Annotated[str | None, _SCHEDULER], None),
    "time_limit": (Annotated[float, _TIME], Limits().seconds),
    "memory_limit": (Annotated[float | None, _MEMORY], None),
    "plugins": (Annotated[list[str] | None, _PLUGIN], None),
    "force": (Force, False),
    "follow_symlinks": (Links, False),
    "include": (Annotated[list[str] | None, _INCLUDE], None),
    "exclude": (Annotated[list[str] | None, _EXCLUDE], None),
    "plots": (Annotated[Literal["interactive", "static"] | None, _PLOTS], None),
}
# Common options of the commands that run the whole pipeline, and which recordings of a folder some of them take.
SELECTION = ("include", "exclude")
PIPELINE = tuple(name for name in COMMON if name not in SELECTION)


def takes(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator of a command: add common options, which it receives as the dictionary `common`."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        keyword = inspect.Parameter.KEYWORD_ONLY
        given = inspect.signature(command, eval_str=True).parameters.values()
        own = [parameter.replace(kind=keyword) for parameter in given if parameter.name != "common"]
        shared = [
            inspect.Parameter(name, keyword, default=COMMON[name][1], annotation=COMMON[name][0])
            for name in names
        ]

        @functools.wraps(command)
        def with_common(**values: Any) -> None:
            common = {name: values.pop(name) for name in names}
            command(common=common, **values)

        parameters = sorted(own + shared, key=lambda p: p.default is not inspect.Parameter.empty)
        vars(with_common)["__signature__"] = inspect.Signature(parameters)
        with_common.__annotations__ = {p.name: p.annotation for p in parameters}
        return with_common

    return decorate


def results_console(width: int | None = None) -> Console:
    """Console for results, on standard output."""
    from rich.console import Console

    class Closable(Console):
        def on_broken_pipe(self) -> None:
            """Leave it to `Command`: rich ends with the exit code of an internal error."""
            raise BrokenPipeError

    return Closable(width=width)


def console() -> Console:
    """Console for messages, on standard error."""
    from rich.console import Console

    # A log file has no width: lines must not be truncated.
    return Console(stderr=True, width=None if sys.stderr.isatty() else 160)


def results_folder(target: Path) -> Path:
    """``NAME-results`` in the working folder, never among the recordings: beside their folder if that is the place."""
    source = real(target)
    folder = source.parent if source.is_file() else source
    name = f"{source.stem if source.is_file() else source.name}-results"
    return folder.parent / name if Path.cwd().is_relative_to(folder) else Path(name)


def run_options(
    out: Path,
    *,
    jobs: int | None = None,
    time_limit: float | None = None,
    memory_limit: float | None = None,
    plugins: list[str] | None = None,
    include: list[str] | None = None,
    exclude: list[str] | None = None,
    **others: Any,
) -> Options:
    """Options of a run from those of the command line; `others` are passed on unchanged."""
    from modalcam.commands import Options
    from modalcam.config import CameraConfig, camera_given
    from modalcam.inputs import Selection

    if out == Path("-"):
        msg = "-o -: results are a folder of files; give its name. `--json` prints a summary on standard output."
        raise ModalcamError(msg)
    given = {name: others.pop(name) for name in tuple(others) if name in CameraConfig.model_fields}
    memory_bytes = None if memory_limit is None else round(1e9 * memory_limit)
    limits = Limits(Limits().seconds if time_limit is None else time_limit, memory_bytes)
    return Options(
        out=out,
        camera=camera_given(given, prefix="--"),
        jobs=jobs or os.cpu_count() or 1,
        limits=limits,
        plugins=tuple(plugins or ()),
        selection=Selection(tuple(include or ()), tuple(exclude or ())),
        **others,
    )


def compute(
    command: Callable[[Options, Progress], RunResult],
    options: Options,
    verbose: int,
    *,
    as_json: bool = False,
    quiet: bool = False,
    strict: bool = False,
    progress: ProgressFormat = "text",
) -> NoReturn:
    """Run a command of `modalcam.commands` with a progress display, print the outcome and exit."""
    from modalcam.console import JsonProgress, finish, listener

    told = JsonProgress() if progress == "json" else None

    def computed() -> ExitCode:
        with (
            nullcontext(told)
            if told
            else listener(console(), -1 if quiet else verbose, whole_run=True) as shown
        ):
            result = command(options, shown)
        return finish(
            told.console if told else console(),
            options.out,
            as_json=as_json,
            # The modes are in summary.json.
            quiet=quiet or told is not None,
            strict=strict,
            internal_errors=result.internal_errors,
        )

    raise typer.Exit(told.ended(computed) if told else computed())

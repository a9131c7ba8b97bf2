"""Commands of the program: how one is registered, and what all have in common."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any, Literal

import typer
from typer.core import TyperCommand

from modalcam.cli.options import CONFIG_HELP
from modalcam.common import ExitCode, InputError
from modalcam.pipeline import low_memory_limits

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

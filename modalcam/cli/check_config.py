"""``modalcam check-config``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def check_config(
    config: Annotated[Path, typer.Argument(help="An experiment.toml.")],
) -> None:
    """Check a configuration and print it as resolved."""
    from modalcam.config.toml import dump_config, load_config

    typer.echo(dump_config(load_config(config)), nl=False)

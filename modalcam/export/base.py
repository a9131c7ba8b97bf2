"""What an output format is: a description and the files that it contributes to OUT."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from modalcam.config.schema import ExperimentConfig
from modalcam.pipeline.results import RunResult
from modalcam.storage.output_folder import Workspace


@dataclass(frozen=True)
class Output:
    """A file of OUT, the results that it shows, and the function that writes it, whole or not at all.

    A file is written again only when `shows` or the code has changed.
    """

    path: Path
    shows: object
    write: Callable[[Path], object]


@dataclass(frozen=True)
class Writer:
    """One output format.

    Attributes
    ----------
    name : str
        Unique among the writers.
    files : str
        Path pattern in OUT, such as ``tracks/<recording>.csv``.
    description : str
        Content of a file, for docs/files.md.
    outputs : callable
        Of workspace, result of the run and configuration: the files to write.
    library, extra : str
        Optional module that the format needs, and the extra of modalcam that installs it; empty when there is none.
    """

    name: str
    files: str
    description: str
    outputs: Callable[[Workspace, RunResult, ExperimentConfig], Iterable[Output]]
    library: str = ""
    extra: str = ""

    @property
    def missing(self) -> str:
        """Sentence about the library that the format lacks; empty when it can be written."""
        if not self.library or importlib.util.find_spec(self.library) is not None:
            return ""
        return f"{self.files} was not written: {self.library} is not installed; " + install_hint(self.extra)

    def write(self, workspace: Workspace, result: RunResult, config: ExperimentConfig) -> None:
        """Write all files of the format."""
        for output in self.outputs(workspace, result, config):
            output.write(output.path)


def install_hint(extra: str) -> str:
    """Command that installs an optional part of modalcam."""
    return f'install it with pip install "modalcam[{extra}]".'

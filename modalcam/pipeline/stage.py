"""A stage of a run: a function that worker processes call, and whose results are saved until an input changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from modalcam.config.schema import ExperimentConfig
from modalcam.execution.pool import TaskFailure, WorkerPool
from modalcam.execution.progress import Progress
from modalcam.storage.cache import load, save
from modalcam.storage.output_folder import Workspace
from modalcam.storage.provenance import code_state, stage_key

Result = TypeVar("Result")

# Name of the saved results of a run as a whole; names of recordings never begin with a dot.
RUN = ".beam"


@dataclass(frozen=True)
class Context:
    """What all stages of a run share.

    Attributes
    ----------
    config : ExperimentConfig
    workspace : Workspace
    pool : WorkerPool
    progress : Progress
    seed : int
    force : bool
        Compute again what was saved.
    results : dict of dict of str
        Key of each result of this run, by name of the recording and of the stage's file; stages add theirs.
    """

    config: ExperimentConfig
    workspace: Workspace
    pool: WorkerPool
    progress: Progress
    seed: int
    force: bool
    results: dict[str, dict[str, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class InputFile:
    """A recording: where it is, and the hash of its content. Only the content counts as an input of a stage."""

    path: Path = field(compare=False)
    sha256: str


@dataclass(frozen=True)
class Stage(Generic[Result]):
    """One step of a run, for each recording or once for the run.

    The parameters of `function` are the inputs of the stage: they, all of them, together with the code of `packages`
    are hashed into the key under which a result is saved.

    Attributes
    ----------
    name : str
        In the field's words, for the terminal.
    file : str
        Result of recording NAME is saved in OUT/state/NAME.file.npz.
    packages : tuple of str
        Packages or modules of ours whose code the result depends on; plugins and libraries are always included.
    function : callable
        Called in a worker process with the inputs by name; returns an instance of frozen dataclasses of ours.
    failed : callable
        Result of a task that was stopped or died, from the name of the recording and the reason. It is not saved.
    per_run : bool
        Whether there is one result for the run, under the name `RUN`.
    """

    name: str
    file: str
    packages: tuple[str, ...]
    function: Callable[..., Result]
    failed: Callable[[str, str], Result]
    per_run: bool = False

    def key(self, inputs: Mapping[str, Any]) -> str:
        """Hash of everything that the result of these inputs depends on."""
        return stage_key(self.file, code=code_state(*self.packages), **inputs)

    def run(self, context: Context, inputs: Mapping[str, Mapping[str, Any]]) -> dict[str, Result]:
        """Result for each recording, from its saved file if no input has changed.

        Parameters
        ----------
        context : Context
        inputs : mapping of mapping
            Arguments of `function` by name of the recording.
        """
        results: dict[str, Result] = {}
        tasks: dict[str, _Task] = {}
        context.progress.begin(self.name, len(inputs))
        for name, arguments in inputs.items():
            path, key = context.workspace.state(name, self.file), self.key(arguments)
            saved = None if context.force else load(path, key)
            if saved is None:
                tasks[name] = _Task(self.function, arguments, path, key)
                continue
            results[name] = cast("Result", saved)
            context.results.setdefault(name, {})[self.file] = key
            context.progress.advance(self._shown(name), reused=True)
        names = list(tasks)
        outcomes = context.pool.map(
            _compute_and_save,
            list(tasks.values()),
            done=lambda index: context.progress.advance(self._shown(names[index])),
            unit="task" if self.per_run else "recording",
        )
        for name, outcome in zip(names, outcomes, strict=True):
            if isinstance(outcome, TaskFailure):
                results[name] = self.failed(name, outcome.reason)
            else:
                results[name] = outcome
                context.results.setdefault(name, {})[self.file] = tasks[name].key
        return results

    def run_once(self, context: Context, **inputs: Any) -> Result:
        """Result of a stage that has one for the run."""
        return self.run(context, {RUN: inputs})[RUN]

    def _shown(self, name: str) -> str:
        return "beam" if self.per_run else name


@dataclass(frozen=True)
class _Task:
    function: Callable[..., Any]
    inputs: Mapping[str, Any]
    path: Path
    key: str


def _compute_and_save(task: _Task) -> Any:
    """Run in a worker, which saves the result itself: an interrupted run loses nothing that has ended."""
    value = task.function(**task.inputs)
    save(task.path, task.key, value)
    return value

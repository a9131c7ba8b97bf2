"""A stage of a run: a function that worker processes call, and whose results are saved until an input changes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from modalcam.config.schema import ExperimentConfig
from modalcam.errors import InputError
from modalcam.execution.frame_count import FrameCount
from modalcam.execution.pool import Progress, TaskFailure, WorkerPool
from modalcam.pipeline.results import RUN, STAGE_FIELDS, RecordingResult
from modalcam.storage.atomic import temporary_name
from modalcam.storage.cache import load, save
from modalcam.storage.output_folder import Workspace
from modalcam.storage.provenance import code_state, stage_key

Result = TypeVar("Result")


@dataclass(frozen=True)
class Context:
    """What all stages of a run share; `results` holds the key of each result by recording and stage's file."""

    config: ExperimentConfig
    workspace: Workspace
    pool: WorkerPool
    progress: Progress
    seed: int
    force: bool
    results: dict[str, dict[str, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class InputFile:
    """A recording among the inputs of a stage, whose function receives the path; only the content counts as input."""

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
    counts_frames : bool
        Whether the function takes a listener ``progress``, called with the number of frames done and declared.
    """

    name: str
    file: str
    packages: tuple[str, ...]
    function: Callable[..., Result]
    failed: Callable[[str, str], Result]
    counts_frames: bool = False

    def each(
        self,
        context: Context,
        recordings: Iterable[RecordingResult],
        inputs: Callable[[RecordingResult], Mapping[str, Any] | Result | None],
    ) -> list[RecordingResult]:
        """The recordings with their results; `inputs` gives those of one, its result, or None where it is skipped."""
        recordings = list(recordings)
        prepared = {r.name: inputs(r) for r in recordings}
        given = {name: value for name, value in prepared.items() if isinstance(value, Mapping)}
        found: dict[str, Any] = {name: value for name, value in prepared.items() if value is not None}
        if given:
            found |= self.run(context, given)
        field_name = STAGE_FIELDS[self.file]
        new: dict[str, Any] = {name: {field_name: value} for name, value in found.items()}
        return [replace(r, **new.get(r.name, {})) for r in recordings]

    def once(self, context: Context, **inputs: Any) -> Result:
        """Result of a stage that has one for the run."""
        return self.run(context, {RUN: inputs})[RUN]

    def run(self, context: Context, inputs: Mapping[str, Mapping[str, Any]]) -> dict[str, Result]:
        """Result for each recording, whose inputs are given by its name; from the saved file if none has changed."""
        results: dict[str, Result] = {}
        tasks: dict[str, _Task] = {}
        context.progress.begin(self.name, len(inputs))
        for name, arguments in inputs.items():
            key = stage_key(self.file, code=code_state(*self.packages), **arguments)
            path = context.workspace.state(name, self.file)
            saved = None if context.force else _saved(path, key, context.progress)
            if saved is None:
                counter = FrameCount(temporary_name(path.with_suffix(".n")))
                tasks[name] = _Task(self.function, arguments, path, key, counter, self.counts_frames)
                continue
            results[name] = cast("Result", saved)
            context.results.setdefault(name, {})[self.file] = key
            context.progress.advance(_shown(name), reused=True)
        if tasks:
            context.workspace.reopen()
        names = list(tasks)
        outcomes = context.pool.map(
            _compute_and_save,
            list(tasks.values()),
            done=lambda index: context.progress.advance(_shown(names[index])),
            look=lambda: _tell_counts(tasks, context.progress),
            unit="task" if all(name.startswith(RUN) for name in inputs) else "recording",
        )
        for name, outcome in zip(names, outcomes, strict=True):
            # That of a process that died.
            tasks[name].counter.end()
            if isinstance(outcome, TaskFailure):
                results[name] = self.failed(name, outcome.reason)
            else:
                results[name] = outcome
                context.results.setdefault(name, {})[self.file] = tasks[name].key
        return results


def _saved(path: Path, key: str, progress: Progress) -> Any:
    """Saved result; None if there is none with this key, or if it is damaged."""
    try:
        return load(path, key)
    except InputError:
        progress.say(f"{path}: damaged; this result is computed again")
        return None


def _shown(name: str) -> str:
    """Without the dot of the run as a whole, and of a part of its results the name of that alone."""
    return name.rpartition(".")[2] if name.startswith(RUN) else name


@dataclass(frozen=True)
class _Task:
    function: Callable[..., Any]
    inputs: Mapping[str, Any]
    path: Path
    key: str
    counter: FrameCount
    counts_frames: bool


def _tell_counts(tasks: Mapping[str, _Task], progress: Progress) -> None:
    for name, task in tasks.items():
        frames = task.counter.read()
        if frames is not None:
            progress.within(_shown(name), *frames)


def _compute_and_save(task: _Task) -> Any:
    """Run in a worker, which saves the result itself: an interrupted run loses no finished result."""
    given = {k: v.path if isinstance(v, InputFile) else v for k, v in task.inputs.items()}
    if task.counts_frames:
        given["progress"] = task.counter
    task.counter.begin()
    try:
        value = task.function(**given)
    finally:
        task.counter.end()
    save(task.path, task.key, value)
    return value

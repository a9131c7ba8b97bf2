"""A stage of a run, of the core or added: a function that worker processes call, and whose results are saved."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar, cast

from modalcam.common import InputError
from modalcam.config import ExperimentConfig
from modalcam.pipeline.atomic import temporary_name
from modalcam.pipeline.cache import load, save
from modalcam.pipeline.output_folder import Workspace
from modalcam.pipeline.pool import TaskFailure, WorkerPool
from modalcam.pipeline.provenance import code_state, stage_key
from modalcam.pipeline.results import RUN, STAGE_FIELDS, RecordingResult

if TYPE_CHECKING:
    from sim.beam import BeamProperties
    from sim.damping import MeasuredDamping

# Frames done and declared; 0 from the beginning of the task on.
_COUNT = struct.Struct("<QQ")
# Frames from one writing to the next: it costs as much as a hundredth of a small frame.
_EVERY = 8


@dataclass(frozen=True)
class FrameCount:
    """The count of one task, which the worker writes and the parent reads."""

    path: Path

    def begin(self) -> None:
        """Note that the task has begun."""
        # Progress must not end a task: a full disk is noticed when the result is saved.
        with suppress(OSError):
            self.path.write_bytes(_COUNT.pack(0, 0))

    def __call__(self, done: int, declared: int) -> None:
        """Note the frames done, now and then; as the listener of `tracker.track.track`."""
        if done % _EVERY == 0 or done == declared:
            # Not emptied before: the system writes a file that is emptied to the disk when it is closed.
            with suppress(OSError), self.path.open("r+b", buffering=0) as file:
                file.write(_COUNT.pack(done, max(declared, 0)))

    def read(self) -> tuple[int, int] | None:
        """Frames done and declared, 0 where unknown; None where the task has not begun or has ended."""
        try:
            done, declared = _COUNT.unpack(self.path.read_bytes())
        except (OSError, struct.error):
            return None
        return int(done), int(declared)

    def end(self) -> None:
        """Remove the file."""
        with suppress(OSError):
            self.path.unlink()


Result = TypeVar("Result")


class Progress:
    """Listener to the stages of a run, which shows nothing. Calls come from the thread that runs the pipeline."""

    def begin(self, stage: str, total: int) -> None:
        """`stage` starts with `total` tasks."""

    def advance(self, name: str, *, reused: bool = False) -> None:
        """The task `name`, if it has one, of the current stage has ended; `reused` if its saved result was valid."""

    def within(self, name: str, frames: int, declared: int) -> None:
        """The task `name` of the current stage has begun; if it counts them, `frames` of `declared` are done."""

    def say(self, text: str) -> None:
        """Show a message now, such as the response to an interrupt."""

    def note(self, text: str) -> None:
        """Show a message that is neither a failure nor a warning."""
        self.say(text)


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
        return each_together(context, recordings, (self, inputs))

    def filled(
        self, recordings: Iterable[RecordingResult], results: Mapping[str, Any]
    ) -> list[RecordingResult]:
        """The recordings with the results of this stage that are given by name."""
        key = STAGE_FIELDS.get(self.file)

        def fill(recording: RecordingResult) -> RecordingResult:
            if recording.name not in results:
                return recording
            value = results[recording.name]
            if key is None:
                return replace(recording, added={**recording.added, self.file: value})
            return replace(recording, **{key: value})

        return [fill(recording) for recording in recordings]

    def prepared(
        self, context: Context, inputs: Mapping[str, Mapping[str, Any]], reused: Callable[..., None]
    ) -> tuple[dict[str, Result], dict[str, _Task]]:
        """Saved results whose inputs have not changed, each told to `reused`, and tasks that give the others."""
        results: dict[str, Result] = {}
        tasks: dict[str, _Task] = {}
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
            reused(name, reused=True)
        return results, tasks

    def once(self, context: Context, **inputs: Any) -> Result:
        """Result of a stage that has one for the run."""
        return self.run(context, {RUN: inputs})[RUN]

    def run(self, context: Context, inputs: Mapping[str, Mapping[str, Any]]) -> dict[str, Result]:
        """Result for each recording, whose inputs are given by its name; from the saved file if none has changed."""
        return run_together(context, (self, inputs))[0]


_Inputs = Callable[[RecordingResult], "Mapping[str, Any] | Any | None"]


def each_together(
    context: Context, recordings: Iterable[RecordingResult], *parts: tuple[Stage[Any], _Inputs]
) -> list[RecordingResult]:
    """`Stage.each` of stages of which none needs another's results; see `run_together`."""
    recordings = list(recordings)
    given = [{r.name: inputs(r) for r in recordings} for _, inputs in parts]
    todo = [{name: v for name, v in of.items() if isinstance(v, Mapping)} for of in given]
    found = run_together(context, *((stage, of) for (stage, _), of in zip(parts, todo, strict=True)))
    for (stage, _), values, results in zip(parts, given, found, strict=True):
        known = {name: value for name, value in values.items() if value is not None}
        recordings = stage.filled(recordings, {**known, **results})
    return recordings


def run_together(
    context: Context, *parts: tuple[Stage[Any], Mapping[str, Mapping[str, Any]]]
) -> list[dict[str, Any]]:
    """`Stage.run` of stages of which none needs another's results.

    A process that is left without a task of one stage begins with the next, in the order given; they are shown in
    this order, each when the one before it has ended.
    """
    progress = _OneByOne(context.progress, [(stage.name, len(inputs)) for stage, inputs in parts])
    results: list[dict[str, Any]] = []
    tasks: list[dict[str, _Task]] = []
    for at, (stage, inputs) in enumerate(parts):
        kept, todo = stage.prepared(context, inputs, partial(progress.ended, at))
        results.append(kept)
        tasks.append(todo)
    places = [(at, name) for at, todo in enumerate(tasks) for name in todo]
    if places:
        context.workspace.reopen()
    outcomes = context.pool.map(
        _compute_and_save,
        [tasks[at][name] for at, name in places],
        done=lambda index: progress.ended(*places[index]),
        look=lambda: _tell_counts(tasks[progress.at] if progress.at < len(parts) else {}, context.progress),
        unit="task" if all(name.startswith(RUN) for _, names in parts for name in names) else "recording",
    )
    for (at, name), outcome in zip(places, outcomes, strict=True):
        task, stage = tasks[at][name], parts[at][0]
        # That of a process that died.
        task.counter.end()
        if isinstance(outcome, TaskFailure):
            results[at][name] = stage.failed(name, outcome.reason)
        else:
            results[at][name] = outcome
            context.results.setdefault(name, {})[stage.file] = task.key
    return results


class _OneByOne:
    """Shows stages that run at once one after the other: what ends of a later one is shown when its turn comes."""

    def __init__(self, progress: Progress, stages: Sequence[tuple[str, int]]) -> None:
        self.at = -1
        self._progress = progress
        self._stages = stages
        self._left = [total for _, total in stages]
        self._unseen: list[list[tuple[str, bool]]] = [[] for _ in stages]
        self._next()

    def ended(self, at: int, name: str, *, reused: bool = False) -> None:
        """A task of the stage with index `at` has ended."""
        self._unseen[at].append((_shown(name), reused))
        if at == self.at:
            self._show()

    def _next(self) -> None:
        self.at += 1
        while self.at < len(self._stages) and not self._left[self.at]:
            self.at += 1
        if self.at < len(self._stages):
            self._progress.begin(*self._stages[self.at])
            self._show()

    def _show(self) -> None:
        for name, reused in self._unseen[self.at]:
            self._progress.advance(name, reused=reused)
        self._left[self.at] -= len(self._unseen[self.at])
        self._unseen[self.at].clear()
        if not self._left[self.at]:
            self._next()


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


Beside = Literal["updating", "simulating", "run"]


@dataclass(frozen=True)
class UpdatedBeam:
    """What the recordings are compared with: the updated beam, and the measured damping of its modes."""

    properties: BeamProperties
    damping: MeasuredDamping


@dataclass(frozen=True)
class AddedStage:
    """A stage with one result for each recording or for the run, kept in their `added` under the name of its file.

    Attributes
    ----------
    stage : Stage
        Its `function` runs in a worker process.
    beside : {"updating", "simulating", "run"}
        The stage of the core that it runs beside. One beside "updating" runs in every run, with or without a beam; one
        beside "simulating" needs the updated beam, and its result is dropped where the comparison of its recording
        fails. One beside "run" runs after all others and has one result.
    inputs : callable
        From the context of the run, a recording, or beside "run" the `RunResult`, and the updated beam, which is given
        beside "simulating" only: the arguments of the stage's function, or None for no result. Called in the main
        process.
    """

    stage: Stage[Any]
    beside: Beside
    inputs: Callable[[Context, Any, UpdatedBeam | None], Mapping[str, Any] | None]


# By the file of their stage.
ADDED_STAGES: dict[str, AddedStage] = {}


def register_stage(added: AddedStage) -> None:
    """Add a stage, the name of whose file must be new; ValueError otherwise."""
    file = added.stage.file
    if file in STAGE_FIELDS or ADDED_STAGES.setdefault(file, added) is not added:
        msg = f"a stage with the file {file!r} is registered already; choose another name"
        raise ValueError(msg)


def added_stages(beside: Beside) -> tuple[AddedStage, ...]:
    """The added stages that run beside a stage of the core, in the order in which they were registered."""
    return tuple(added for added in ADDED_STAGES.values() if added.beside == beside)

"""Stages that an app or a plugin adds to a run: the registry and what such a stage is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from modalcam.pipeline.stage import Context, Stage
    from sim.beam import BeamProperties
    from sim.damping import MeasuredDamping

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
    # Loaded here: what a plugin registers is read before a run needs its results.
    from modalcam.pipeline.results import STAGE_FIELDS  # noqa: PLC0415

    file = added.stage.file
    if file in STAGE_FIELDS or ADDED_STAGES.setdefault(file, added) is not added:
        msg = f"a stage with the file {file!r} is registered already; choose another name"
        raise ValueError(msg)


def added_stages(beside: Beside) -> tuple[AddedStage, ...]:
    """The added stages that run beside a stage of the core, in the order in which they were registered."""
    return tuple(added for added in ADDED_STAGES.values() if added.beside == beside)

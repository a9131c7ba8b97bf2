"""Response to a measured input: `response/<recording>.csv`, and `participation.csv` of the modes."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from modal_id import FrequencyResponse, IdentifiedMode
from modalcam.config import ExperimentConfig
from modalcam.pipeline import RecordingResult, RunResult, Workspace
from modalcam.tables.base import Output, Writer
from modalcam.tables.columns import PARTICIPATION_COLUMNS
from modalcam.tables.csv_files import frame, write_table
from tracker import table_row


class Participation(NamedTuple):
    """A mode at one channel of a recording with a measured input."""

    recording: str
    mode: IdentifiedMode
    channel: str
    participation: float
    participation_sd: float
    unit: str
    is_force: bool

    @property
    def modal_mass(self) -> float:
        """Inverse of the participation; NaN for a motion of the base."""
        return 1.0 / self.participation if self.is_force and self.participation else float("nan")

    @property
    def modal_mass_sd(self) -> float:
        """Its standard deviation, to first order."""
        return (
            abs(self.modal_mass / self.participation) * self.participation_sd
            if self.is_force
            else float("nan")
        )


def participations(recording: RecordingResult) -> Iterator[Participation]:
    """One for each mode and channel that was fitted; none without a measured input."""
    found = recording.identified
    if found is None or found.series.known_input is None:
        return
    known = found.series.known_input
    unit = f"{found.series.unit}/({known.unit} s^2)" if known.is_force else "1"
    for mode in found.modes:
        values, errors = mode.participation, mode.participation_sd
        if values is None or errors is None:
            continue
        for k in np.flatnonzero(np.isfinite(values)):
            name = found.series.channels[k]
            yield Participation(
                recording.name, mode, name, float(values[k]), float(errors[k]), unit, known.is_force
            )


def _responses(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
    for recording in result.recordings:
        found = recording.identified
        response = None if found is None else found.response
        if isinstance(response, FrequencyResponse):
            write = partial(write_table, parts=(response.to_dataframe(),))
            yield Output(workspace.response(recording.name), response, write)


def _participations(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
    rows = [table_row(PARTICIPATION_COLUMNS, one) for r in result.recordings for one in participations(r)]
    if rows:
        write = partial(write_table, parts=(frame(rows, PARTICIPATION_COLUMNS),))
        yield Output(workspace.out / "participation.csv", result, write)


RESPONSE = Writer(
    "response",
    "response/<recording>.csv",
    "only with a measured input: frequency response with its 90 % band, the local-polynomial estimate and the "
    "coherence, one row per channel and frequency",
    _responses,
)
PARTICIPATION = Writer(
    "participation",
    "participation.csv",
    "only with a measured input: participation factors, or modal constants and masses of a force, one row per "
    "recording, mode and channel",
    _participations,
)

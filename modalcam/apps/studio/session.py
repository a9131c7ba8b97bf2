"""One studio: its folder, its recordings, the draft of their configuration, and the run."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, TypeVar

from modalcam.apps.studio.draft import Draft
from modalcam.apps.studio.frames import FrameTask, frame_png, stamps_of
from modalcam.apps.studio.next_step import Stand
from modalcam.apps.studio.run import Runner, RunResults, run_results
from modalcam.common import ConfigError, ExitCode, InputError, ModalcamError, real, shown
from modalcam.config import CONFIG_NAME, ExperimentConfig, RecordingConfig, tracker_settings
from modalcam.inputs import RATE_UNKNOWN, Discovery, Found, Probe, discover, probe_recordings
from modalcam.pipeline import FrameCount, Limits, TaskFailure, WorkerPool, Workspace, worker_pool
from tracker import Failure

if TYPE_CHECKING:
    from modal_id import Identification
    from modalcam.apps.studio.decay import Decay, ExpectedIntervals
    from modalcam.apps.studio.trial import DetectedMarker, Proposals, Trial, TrialTask
    from tracker import FailedTracking, MarkerTracks

    # Tracks, options, and what was identified with them.
    _IdentifiedTrial = tuple[MarkerTracks, RecordingConfig, Identification | Failure]

Answer = TypeVar("Answer")
Task = TypeVar("Task")

# One process shows frames while another one counts them.
_DECODERS = 2
_DECODING = Limits(seconds=60.0, memory_bytes=2_000_000_000)
_TRIAL = Limits(seconds=300.0)


@dataclass(frozen=True)
class Pools:
    """Child processes: those that decode, and the one that tracks."""

    decoding: WorkerPool
    tracking: WorkerPool


class Studio:
    """What the pages show and change.

    Methods that decode or track block until a child process has answered; call them in a thread.

    Parameters
    ----------
    folder : Path
        Folder of recordings; nothing is written there but the configuration, when it is saved.
    out : Path or None
        Folder of results and of the draft; None where nothing is run.
    only : str or None
        The only recording wanted of the folder.
    config : Path or None
        The configuration to edit with `only`; None to begin with an empty one that is not saved.

    Attributes
    ----------
    stop : callable
        Ends the server; set by it.
    is_done : bool
        Whether the page has asked for the end.

    Raises
    ------
    ModalcamError
        If the folder holds no recording, OUT is not a folder for results, or the configuration is not valid.
    """

    def __init__(
        self,
        folder: Path,
        out: Path | None,
        pools: Pools,
        *,
        only: str | None = None,
        config: Path | None = None,
    ) -> None:
        self.folder = real(folder)
        self.workspace = None if out is None else Workspace(out.absolute())
        self._pools = pools
        found = discover(folder, exclude=out)
        self.notes = found.notes
        self.recordings = _wanted(found, only)
        if self.workspace is not None:
            self.workspace.prepare(inputs=folder, force=False, target=self.folder.name)
            self.workspace.check_links()
        self.draft = Draft(self._config_path() if only is None else config, self._store())
        self.stop: Callable[[], object] = lambda: None
        self.is_done = False
        self.runner = Runner()
        self._stamps: dict[int, tuple[int | None, ...]] = {}
        self._trials: dict[int, tuple[Trial, ExpectedIntervals | Failure | None]] = {}
        self._identified: dict[int, _IdentifiedTrial] = {}
        self._counter: FrameCount | None = None
        self._to_track = 0
        self._probes: tuple[Probe, ...] | None = None
        self._counting = threading.Lock()
        # Text of the configuration of the last run; recordings without a result in it.
        self._run_text: str | None = None
        self.failures = 0
        self.markers_seen = self.decay_seen = False
        self._stand: tuple[object, Stand] = None, Stand()

    def probes(self) -> tuple[Probe, ...]:
        """Properties of each recording, without its options of the configuration; read once."""
        with self._counting:
            if self._probes is None:
                self._probes = probe_recordings(self.recordings, ExperimentConfig(), self._pools.decoding.map)
            return self._probes

    def frame(self, number: int, index: int, width_px: int | None = None) -> bytes | Failure:
        """PNG of a frame of a recording, by its number in `recordings`."""
        path = self._path(number)
        if isinstance(path, Failure):
            return path
        task = FrameTask(path, index, self._stamps.get(number, ()), width_px)
        return _answer(self._pools.decoding.map(frame_png, [task])[0])

    def missing(self, number: int) -> str:
        """Why a recording cannot be read any more; empty if it can."""
        path = self._path(number)
        return path.reason if isinstance(path, Failure) else ""

    def frame_count(self, number: int) -> int | Failure:
        """Number of frames of a recording; counted once."""
        if number not in self._stamps:
            path = self._path(number)
            if isinstance(path, Failure):
                return path
            found = self._pools.decoding.map(stamps_of, [path])[0]
            stamps: tuple[int | None, ...] | Failure = _answer(found)
            if isinstance(stamps, Failure):
                return stamps
            self._stamps[number] = stamps
        return len(self._stamps[number])

    def detect(self, number: int) -> tuple[DetectedMarker, ...] | Failure:
        """Markers in the first frames of a recording, with the options of the draft."""
        from modalcam.apps.studio.trial import DETECTION_FRAMES, detected  # noqa: PLC0415 - heavy

        self.markers_seen = True
        return self._tracked(detected, self._trial_task(number, DETECTION_FRAMES))

    def propose(self, number: int) -> Proposals | Failure:
        """Points of the first frame whose surroundings have texture and move, and the line of a strip that moves."""
        from modalcam.apps.studio.trial import DETECTION_FRAMES, proposed  # noqa: PLC0415 - heavy

        return self._tracked(proposed, self._trial_task(number, DETECTION_FRAMES))

    def window_sizes(self, number: int) -> tuple[float, ...]:
        """Side of the window of each patch of a recording in px, as a run chooses it; empty where it would fail."""
        from modalcam.apps.studio.trial import window_sizes  # noqa: PLC0415 - heavy

        found = self._tracked(window_sizes, self._trial_task(number, 1))
        return () if isinstance(found, Failure) else found

    def track_some(self, number: int, frames: int, first: int = 0) -> Trial | FailedTracking:
        """Test track of some frames of a recording, from `first` on, with the options of the draft."""
        from modalcam.apps.studio.trial import TrialCount, trial_track  # noqa: PLC0415 - heavy
        from tracker import FailedTracking  # noqa: PLC0415

        task, count = self._trial_task(number, frames), self.frame_count(number)
        self._to_track = 0 if isinstance(count, Failure) else min(first + frames, count)
        with TemporaryDirectory() as folder:
            self._counter = TrialCount(Path(folder) / "count")
            self._counter.begin()
            if not isinstance(task, Failure):
                task = replace(task, counter=self._counter, first=first)
            found: Trial | FailedTracking | Failure = self._tracked(trial_track, task)
        if isinstance(found, Failure):
            found = FailedTracking(found.reason, self.recordings[number].file)
        if isinstance(found, FailedTracking):
            self._trials.pop(number, None)
        else:
            self._trials[number] = found, None
        return found

    def frames_tracked(self) -> tuple[int, int]:
        """Frames that the test track now going on is done with, 0 while markers are learned, and all of them."""
        counted = self._counter and self._counter.read()
        return counted[0] if counted else 0, self._to_track

    def cancel_trial(self) -> None:
        """End the test track that goes on at its next frame."""
        if self._counter is not None:
            self._counter.end()

    def trial(self, number: int) -> tuple[Trial, ExpectedIntervals | Failure | None] | None:
        """The last test track of a recording and what a run would give, None until `expect` has found out.

        None without a test track, or where it failed.
        """
        return self._trials.get(number)

    def expect(self, number: int) -> None:
        """Predict what a run would give of a recording from its test track, if there is one."""
        from modalcam.apps.studio.decay import USUAL_DAMPING_RATIOS, ExpectedTask, expected_intervals  # noqa: PLC0415 - heavy

        last, frames = self.trial(number), self.frame_count(number)
        if last is None:
            return
        tracks, ratios = last[0].tracks, self.draft.config.plan.damping_ratio or USUAL_DAMPING_RATIOS
        task = (
            frames
            if isinstance(frames, Failure)
            else ExpectedTask(tracks, frames - int(tracks.frame[0]), ratios)
        )
        expected = self._tracked(expected_intervals, task)
        # Unless it was tracked again meanwhile.
        if self.trial(number) is last:
            self._trials[number] = last[0], expected

    def decay(self, number: int, channel: str | None = None) -> Decay | Failure:
        """What the last run found in a recording; of the channel that moves most, unless another is named."""
        from modalcam.apps.studio.decay import DecayTask, decay_of  # noqa: PLC0415 - heavy

        if self.workspace is None:
            return Failure("there is no folder for results")
        task = DecayTask(self.workspace.out, self.recordings[number].file, channel)
        return self._tracked(decay_of, task)

    def decay_of_trial(self, number: int, channel: str | None = None) -> Decay | Failure:
        """What the test track of a recording shows, identified with the options of the draft."""
        from modal_id import Identification  # noqa: PLC0415 - heavy
        from modalcam.apps.studio.decay import (  # noqa: PLC0415
            TrialDecayTask,
            identified_trial,
            shown_decay,
            without_driven,
        )
        from tracker import displacement_series  # noqa: PLC0415

        last = self.trial(number)
        if last is None:
            return Failure("there is no test track; track the first frames, or all, under Test track")
        tracks, recording = last[0].tracks, self.draft.recording(self.recordings[number].file)
        known = self._identified.get(number)
        if known is None or known[0] is not tracks or known[1] != recording:
            answer: Identification | Failure
            answer = self._tracked(identified_trial, TrialDecayTask(tracks, recording))
            known = self._identified[number] = tracks, recording, answer
        found = known[2]
        if isinstance(found, Identification):
            shown = shown_decay(found.series, found, channel)
            frames = self.frame_count(number)
            # Where no frame follows, the run sees no more either.
            if isinstance(shown, Failure) or isinstance(frames, Failure) or tracks.frame[-1] + 1 >= frames:
                return shown
            return without_driven(shown, int(tracks.frame[0]), int(tracks.frame[-1]), frames)
        try:
            shown = shown_decay(displacement_series(tracks), None, channel)
        except ValueError as error:
            return Failure(str(error))
        return shown if isinstance(shown, Failure) else replace(shown, doubts=(found.reason,))

    def _tracked(
        self, function: Callable[[Task], Answer | Failure], task: Task | Failure
    ) -> Answer | Failure:
        if isinstance(task, Failure):
            return task
        return _answer(self._pools.tracking.map(function, [task])[0])

    def _trial_task(self, number: int, frames: int) -> TrialTask | Failure:
        from modalcam.apps.studio.trial import TrialTask  # noqa: PLC0415 - heavy

        path = self._path(number)
        if isinstance(path, Failure):
            return path
        file = self.recordings[number].file
        try:
            return TrialTask(path, file, tracker_settings(self.draft.recording(file)), frames)
        except (ModalcamError, ValueError) as error:
            return Failure(str(error))

    def start_run(self) -> None:
        """Start the run of the configuration as it is saved; ModalcamError while one is going on."""
        if self.workspace is None:
            msg = "there is no folder for results; start `modalcam studio FOLDER -o OUT`"
            raise ModalcamError(msg)
        beside = self.draft.path == self.folder / CONFIG_NAME
        config = None if beside or not self.draft.path.exists() else self.draft.path
        options = self.draft.config
        frames = {
            found.name: probe.packets
            for found, probe in zip(self.recordings, self._probes or (), strict=False)
            if probe.packets is not None and not options.for_recording(found.file).leave_out
        }
        self.runner.start(self.folder, self.workspace.out, config, frames)
        self._run_text, self.decay_seen = self.draft.text, False

    def results(self) -> RunResults | Failure:
        """Modes and failures of the last run, where `report` gives one."""
        summary = None if self.workspace is None else self.workspace.summary
        if summary is None or not summary.is_file() or summary.is_symlink():
            return Failure("there are no results yet")
        found = run_results(summary)
        self.failures = len(found.failures) if isinstance(found, RunResults) else 0
        return found

    def report(self) -> Path | None:
        """The report of the last run; None without one, and where it is a link."""
        found = None if self.workspace is None else self.workspace.report
        return found if found is not None and found.is_file() and not found.is_symlink() else None

    def stand(self) -> Stand:
        """How far the work is."""
        known = self.draft.version, self._probes is None
        if self._stand[0] != known:
            self._stand = known, self._stand_of_draft()
        stand = self._stand[1]
        return replace(
            stand,
            markers_seen=stand.markers_seen or self.markers_seen,
            is_tracked=bool(self._trials),
            is_running=self.runner.is_running,
            is_reported=self._is_reported(),
            failures=self.failures,
            decay_seen=self.decay_seen,
        )

    def _stand_of_draft(self) -> Stand:
        """How far the work is by the options and what the files hold."""
        options = self.draft.config
        notes = ((),) * len(self.recordings) if self._probes is None else [p.notes for p in self._probes]
        own = [options.for_recording(found.file) for found in self.recordings]
        wanted = [(one, of) for one, of in zip(own, notes, strict=True) if not one.leave_out]
        is_unknown = (one.fps is None and any(n.startswith(RATE_UNKNOWN) for n in of) for one, of in wanted)
        problems = (f"{shown(one.file)}: {why}" for one, _ in wanted if (why := _contradiction(one)))
        return Stand(
            is_read=self._probes is not None,
            recordings=len(wanted),
            without_rate=tuple(
                shown(one.file) for (one, _), so in zip(wanted, is_unknown, strict=True) if so
            ),
            problem=next(problems, ""),
            has_beam=options.beam is not None and not options.beam.missing(),
            markers_seen=any(one.points_px or one.line_px for one, _ in wanted),
        )

    def _is_reported(self) -> bool:
        """Whether there is a report, and no change since: none of the page, and none of the file."""
        found = self.report()
        if found is None or self.draft.is_changed or self.runner.is_running:
            return False
        path = self.draft.path
        newer = path.exists() and path.stat().st_mtime > found.stat().st_mtime
        # A run that finds nothing to do leaves the report as it is.
        state = self.runner.state
        has_run = state is not None and state.exit_code in (ExitCode.OK, ExitCode.PARTIAL)
        return not newer or (has_run and self._run_text == self.draft.text)

    def _path(self, number: int) -> Path | Failure:
        if not 0 <= number < len(self.recordings):
            return Failure(f"there is no recording {number}; reload the page")
        found = self.recordings[number]
        # It may have been replaced since it was found.
        inside = real(found.path).is_relative_to(self.folder) and not found.path.is_symlink()
        if not inside or not found.path.exists():
            return Failure(
                f"{shown(found.file)}: the recording is no longer there; put it back, or start again"
            )
        return found.path

    def _config_path(self) -> Path:
        """The folder's configuration; one in OUT where the folder has none and cannot be written."""
        beside = self.folder / CONFIG_NAME
        if beside.exists() or os.access(self.folder, os.W_OK) or self.workspace is None:
            return beside
        return self.workspace.out / CONFIG_NAME

    def _store(self) -> Path | None:
        return None if self.workspace is None else self.workspace.studio_draft


def _wanted(found: Discovery, only: str | None) -> tuple[Found, ...]:
    if only is None:
        return found.recordings
    wanted = tuple(recording for recording in found.recordings if recording.file == only)
    if not wanted:
        msg = f"{shown(only)}: not a recording that can be read; see `modalcam probe`"
        raise InputError(msg)
    return wanted


def _answer(result: Answer | TaskFailure) -> Answer | Failure:
    return Failure(result.reason) if isinstance(result, TaskFailure) else result


@contextmanager
def pools() -> Iterator[Pools]:
    """Child processes of a studio, started when they are needed and ended with the block."""
    with worker_pool(_DECODERS, _DECODING) as decoding, worker_pool(1, _TRIAL) as tracking:
        yield Pools(decoding, tracking)


def options_error(draft: Draft, file: str) -> str:
    """What contradicts in the options of a recording; empty if nothing does."""
    return _contradiction(draft.recording(file))


def _contradiction(recording: RecordingConfig) -> str:
    try:
        tracker_settings(recording)
    except (ConfigError, ValueError) as error:
        return str(error)
    return ""

"""The run: started after the configuration is saved, its progress, its outcome and the report."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from nicegui import ui

from modalcam.errors import ExitCode
from modalcam.names import shown
from modalcam.studio.running import RunState, StageState
from modalcam.studio.views.saving import SaveDialog
from modalcam.studio.views.shared import PageState, heading, scrolled, table_head

_TICK_S = 0.3
# Rows of the table of stages.
_MOST_ROWS = 100


class RunView:
    """Buttons, progress and report."""

    def __init__(self, state: PageState, save: SaveDialog) -> None:
        self._state = state
        self._save = save
        self._was_running = False
        heading("Run and report")
        with ui.row().classes("frames"):
            self._start = ui.button("Save and run", on_click=self._ask)
            self._cancel = ui.button("Cancel the run", on_click=state.studio.runner.cancel)
        self._stage = ui.label("").props('role="status"').classes("status")
        self._bar = ui.linear_progress(0.0, show_value=False).props('aria-label="Progress of the stage"')
        self._shown: tuple[object, ...] = ()
        self._cells: dict[tuple[str, int], Any] = {}
        self._stages()
        self._messages = (
            ui.element("pre").classes("messages").props('tabindex="0" aria-label="Messages of the run"')
        )
        with self._messages:
            self._text = ui.label("")
        self._report = ui.element("div").classes("report")
        self._show_report()
        ui.timer(_TICK_S, self._look)
        self._look()

    def _ask(self) -> None:
        self._save.ask(self._run, "Save and run")

    def _run(self) -> None:
        self._state.attempt(self._state.studio.start_run)
        self._look()

    def _look(self) -> None:
        run = self._state.studio.runner.state
        running = run is not None and run.is_running
        self._start.set_enabled(not running)
        self._cancel.set_enabled(running)
        self._bar.visible = running
        self._messages.visible = run is not None and bool(run.messages)
        # That of the run before.
        self._report.visible = not running
        if run is not None:
            self._tell(run)
        if self._was_running and not running:
            self._show_report()
        self._was_running = running

    def _tell(self, run: RunState) -> None:
        now_s = time.monotonic()
        stage = run.stage
        if run.is_running:
            remaining, pace = run.remaining_s(now_s), run.frames_per_s()
            parts = [
                f"{stage.name}: {stage.done} of {stage.total}" if stage.total else stage.name,
                f"{run.elapsed_s(now_s):.0f} s",
                "" if pace is None else f"{pace:.0f} frames a second",
                "" if remaining is None else f"about {remaining:.0f} s left of this stage",
                "it ends after what it works on; press again to stop at once" if run.cancelled else "",
            ]
            self._stage.text = ", ".join(filter(None, parts))
            self._bar.value = run.share
        else:
            self._stage.text = f"The run took {run.elapsed_s(now_s):.0f} s: {run.outcome}."
        self._text.text = "\n".join(map(shown, run.messages))
        self._show_stages(run)

    def _show_stages(self, run: RunState) -> None:
        """Fill in the table in place: one that was built anew would lose the focus."""
        names = {found.name for found in self._state.studio.recordings[:_MOST_ROWS]}
        stages = [s for s in run.stages if names & {*s.computed, *s.reused, *s.working}]
        columns = (id(run), *(stage.name for stage in stages))
        if columns != self._shown:
            self._shown = columns
            self._cells = {}
            self._stages.refresh(stages)
        for (name, k), cell in self._cells.items():
            cell.text = stages[k].state_of(name, is_running=run.is_running, frames=run.frames.get(name))

    @ui.refreshable_method
    def _stages(self, stages: Sequence[StageState] = ()) -> None:
        """What has become of each recording in each stage that works on recordings one by one."""
        if not stages:
            return
        config = self._state.studio.draft.config
        with scrolled(), ui.element("table").classes("list"):
            table_head(("recording", *(stage.name for stage in stages)))
            with ui.element("tbody"):
                for found in self._state.studio.recordings[:_MOST_ROWS]:
                    if config.for_recording(found.file).leave_out:
                        continue
                    with ui.element("tr"):
                        with ui.element("th").props('scope="row"'):
                            ui.label(shown(found.file))
                        for k in range(len(stages)):
                            with ui.element("td"):
                                self._cells[found.name, k] = ui.label("")

    def _show_report(self) -> None:
        self._report.clear()
        if self._state.studio.report() is None:
            return
        with self._report:
            run = self._state.studio.runner.state
            is_of_run = run is None or run.exit_code in (ExitCode.OK, ExitCode.PARTIAL)
            heading("Report" if is_of_run else "Report of an earlier run", 3)
            # A new address each time: the page in the frame is otherwise the one before.
            frame = ui.element("iframe").classes("report-frame")
            frame.props["src"] = f"/report?{time.time_ns()}"
            frame.props["title"] = "Report"
            # Its scripts run without the origin of this page: they reach neither the page nor the studio.
            frame.props["sandbox"] = "allow-scripts"

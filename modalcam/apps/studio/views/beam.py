"""The beam: its geometry, material and mounting, without which nothing is simulated and no damping model compared."""

from __future__ import annotations

from functools import partial
from typing import Any

from nicegui import ui

from modalcam.apps.studio.views.shared import PageState, heading
from modalcam.config import REQUIRED_OF_BEAM, BeamConfig, option

_CHOICES = ("orientation", "material")


class BeamView:
    """Fields of ``[beam]``; their texts and units are those of the configuration."""

    def __init__(self, state: PageState) -> None:
        self._state = state
        heading("Beam")
        ui.label(
            "With its beam, a run numbers the modes, updates the beam and compares models of damping. For this it also "
            "needs the distances of the markers from the clamp, given under Markers."
        )
        self._status = ui.label("").props('role="status"').classes("status")
        with ui.element("div").classes("form"):
            self._fields = {key: self._field(key) for key in (*REQUIRED_OF_BEAM, *_CHOICES, "angle_deg")}
        self._remove = ui.button("Remove the beam", on_click=lambda: self._write(None))
        state.when_draft_changes(self._update)
        self._update()

    def _field(self, key: str) -> Any:
        known = option(f"beam.{key}")
        end = known.unit.lower().replace("/", "_").replace("³", "3").replace("°", "deg")
        unit = f"({known.unit})" if "/" in known.unit else known.unit
        name = key.removesuffix(f"_{end}").replace("_", " ").capitalize()
        label, take = " / ".join(filter(None, (name, unit))), partial(self._take, key)
        if key in _CHOICES:
            field: Any = ui.select(
                ["", *known.type.replace('"', "").split(", ")], label=label, on_change=take
            )
        else:
            field = ui.number(label).on("change", take)
        field.props("outlined dense options-dense hide-bottom-space")
        field.props["hint"] = known.field.description if key in _CHOICES else known.help
        return field

    def _take(self, key: str) -> None:
        values = {name: None if field.value == "" else field.value for name, field in self._fields.items()}
        is_angled = values["orientation"] == "angled"
        # The configuration takes an angle with this orientation only, and not the one without the other.
        self._fields["angle_deg"].visible = is_angled
        changed = {key: values[key]}
        if key in ("orientation", "angle_deg"):
            changed = {
                "orientation": values["orientation"],
                "angle_deg": values["angle_deg"] if is_angled else None,
            }
        if is_angled and values["angle_deg"] is None:
            self._status.text = "Give the angle: the orientation is written with it."
            return
        given = self._state.studio.draft.config.beam or BeamConfig()
        changed = {name: value for name, value in changed.items() if value != getattr(given, name)}
        if changed:
            self._write(changed)

    def _write(self, values: dict[str, Any] | None) -> None:
        self._state.attempt(lambda: self._state.studio.draft.set_section("beam", values))

    def _update(self) -> None:
        beam = self._state.studio.draft.config.beam
        for key, field in self._fields.items():
            value = getattr(beam or BeamConfig(), key)
            field.value = "" if value is None and key in _CHOICES else value
        self._fields["angle_deg"].visible = self._fields["orientation"].value == "angled"
        self._remove.visible = beam is not None
        missing = () if beam is None else beam.missing()
        self._status.text = (
            "Without a beam nothing is simulated."
            if beam is None
            else f"Nothing is simulated without {', '.join(missing)}."
            if missing
            else "The beam is complete."
        )

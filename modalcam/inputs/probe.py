"""What recordings are, without tracking them: frames, rates, time steps, size, depth, problems."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from modalcam.config.schema import ExperimentConfig
from modalcam.config.toml import CONFIG_NAME, load_config
from modalcam.errors import InputError
from modalcam.inputs.discover import Found, discover
from modalcam.names import shown
from tracker.video.base import UnreadableVideoError
from tracker.video.registry import ProbeReport, probe

# Step lengths that are listed before the rest is summed up.
_STEPS_SHOWN = 3


@dataclass(frozen=True)
class Probe:
    """One recording as found; `problem` is empty when it can be read."""

    file: str
    codec: str = ""
    size_px: str = ""
    bit_depth: int = 0
    frames_declared: int = 0
    packets: int = 0
    fps_container: float | None = None
    fps_recorded: float | None = None
    nyquist_hz: float | None = None
    time_steps: str = ""
    problem: str = ""
    notes: tuple[str, ...] = ()


def probe_folder(target: Path, *, follow_symlinks: bool) -> tuple[Probe, ...]:
    """Probe one file, or every recording of a folder.

    Raises
    ------
    InputError, NoInputError
        If there is nothing to probe.
    """
    if target.is_file():
        return (_probe(Found(target.stem, target.name, target.absolute()), ExperimentConfig()),)
    if not target.exists():
        msg = f"{shown(str(target))}: no such file or folder"
        raise InputError(msg)
    config_path = target / CONFIG_NAME
    config = load_config(config_path) if config_path.exists() else ExperimentConfig()
    found = discover(target, follow_symlinks=follow_symlinks)
    return tuple(_probe(recording, config) for recording in found.recordings)


def show_probes(probes: tuple[Probe, ...], console: Console, *, as_json: bool) -> None:
    """Print probes as a table, or as JSON for programs."""
    if as_json:
        typer.echo(json.dumps([asdict(p) for p in probes], indent=1))
        return
    table = Table(
        "recording", "codec", "size / px", "bit", "frames", "fps file", "fps recorded", "steps / ticks"
    )
    for p in probes:
        frames = (
            f"{p.packets}" if p.frames_declared in (0, p.packets) else f"{p.packets} of {p.frames_declared}"
        )
        recorded = "?" if p.fps_recorded is None else f"{p.fps_recorded:g} (Nyquist {p.nyquist_hz:g} Hz)"
        container = "" if p.fps_container is None else f"{p.fps_container:g}"
        cells = (
            shown(p.file),
            p.codec,
            p.size_px,
            str(p.bit_depth or ""),
            frames,
            container,
            recorded,
            p.time_steps,
        )
        table.add_row(*(Text(cell) for cell in cells))
    console.print(table)
    for p in probes:
        for sentence in (*p.notes, p.problem):
            if sentence:
                console.print(Text(f"{shown(p.file)}: {sentence}"))


def _probe(found: Found, config: ExperimentConfig) -> Probe:
    try:
        report = probe(found.path)
    except UnreadableVideoError as error:
        return Probe(found.file, problem=str(error))
    info = report.info
    given = config.for_recording(found.file).fps
    fps, frame_rate = given or info.header_rate, given or info.frames_per_s
    notes = list(info.notes)
    if fps is None:
        which = "it holds none" if info.container_rate is None else "the file's rate is that of playback"
        notes.append(f"the recorded rate is not known: {which}; give --fps or [camera] fps")
    if given is None and info.frame_step > 1:
        notes.append(f"of the frames that were recorded, one in {info.frame_step} is in the file")
    if report.stamps_missing:
        notes.append(f"{report.stamps_missing} of {report.packets} frames have no time stamp")
    return Probe(
        file=found.file,
        codec=f"{info.codec} {info.pixel_format}",
        size_px=f"{info.width_px} x {info.height_px}",
        bit_depth=info.bit_depth,
        frames_declared=info.frames_declared,
        packets=report.packets,
        fps_container=None if info.container_rate is None else float(info.container_rate),
        fps_recorded=None if fps is None else float(fps),
        nyquist_hz=None if frame_rate is None else float(frame_rate) / 2.0,
        time_steps=_steps(report),
        problem="" if report.first_frame is not None else "no frame of it can be decoded",
        notes=tuple(notes),
    )


def _steps(report: ProbeReport) -> str:
    ordered = sorted(report.step_ticks.items(), key=lambda item: -item[1])
    text = ", ".join(f"{count} x {ticks}" for ticks, count in ordered[:_STEPS_SHOWN])
    rest = len(ordered) - _STEPS_SHOWN
    return f"{text} and {rest} others" if rest > 0 else text

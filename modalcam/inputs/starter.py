"""A commented `experiment.toml` for the recordings of a folder: every option, and one entry per recording."""

from __future__ import annotations

from pathlib import Path

from modalcam.config.reference import commented_toml, toml_value
from modalcam.inputs.probe import Probe, probe_folder
from modalcam.names import shown


def starter_config(folder: Path) -> str:
    """Text of a configuration for the recordings of `folder`.

    Raises
    ------
    InputError, NoInputError
        If the folder holds no recordings.
    """
    probes = probe_folder(folder, follow_symlinks=False)
    return commented_toml() + "".join(_entry(p) for p in probes)


def _entry(p: Probe) -> str:
    if p.problem:
        return f"\n# {shown(p.file)}: {shown(' '.join(p.problem.split()))}\n"
    if not p.file.isprintable():
        return f"\n# {shown(p.file)}: rename the file to configure it; TOML cannot hold its name\n"
    rate = "unknown" if p.fps_container is None else f"{p.fps_container:g}"
    return (
        f"\n# {p.packets} frames of {p.size_px} px, {p.bit_depth} bit, {p.codec}; frame rate in the file: {rate}\n"
        f"[[recordings]]\nfile = {toml_value(p.file)}\n#mode = 1\n#fps = 1000.0\n"
    )

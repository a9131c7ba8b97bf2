"""``modalcam probe``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modalcam.cli.options import Json, Links, results_console
from modalcam.common import ExitCode

if TYPE_CHECKING:
    from modalcam.inputs import Probe


def probe(
    folder: Annotated[
        Path, typer.Argument(metavar="FILE|FOLDER", help="Recording, or folder of recordings.")
    ],
    follow_symlinks: Links = False,
    json_: Json = False,
) -> None:
    """Show frame rate, size, markers and problems of recordings."""
    import json
    from dataclasses import asdict

    from modalcam.inputs import probe_folder
    from modalcam.pipeline import worker_pool

    # In another process: a recording may be made to need any time or memory.
    with worker_pool(1) as pool:
        probes = probe_folder(folder, follow_symlinks=follow_symlinks, each=pool.map)
    if json_:
        typer.echo(json.dumps([asdict(p) for p in probes], indent=1))
    else:
        _show(probes)
    raise typer.Exit(ExitCode.OK if all(p.problem == "" for p in probes) else ExitCode.PARTIAL)


def _show(probes: tuple[Probe, ...]) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.table import Column, Table
    from rich.text import Text

    from modalcam.common import shown

    console = results_console()
    # Folded, never cut.
    widths = {
        "recording": 15,
        "codec": 8,
        "size / px": 9,
        "bits": 4,
        "frames": 6,
        "fps in file": 7,
        "fps recorded": 8,
    }
    heads = [Column(head, overflow="fold", min_width=width) for head, width in widths.items()]
    table = Table(*heads, box=SIMPLE_HEAD, pad_edge=False)
    for p in probes:
        declared = "" if p.frames_declared in (0, p.packets) else f" of {p.frames_declared}"
        recorded = "?" if p.fps_recorded is None else f"{p.fps_recorded:g}"
        in_file = "" if p.fps_container is None else f"{p.fps_container:g}"
        bits, frames = str(p.bit_depth or ""), f"{p.packets}{declared}"
        cells = (shown(p.file), p.codec, p.size_px, bits, frames, in_file, recorded)
        table.add_row(*map(Text, cells))
    console.print(table)
    for p in probes:
        uneven = f"time stamps differ by {p.time_steps} ticks." if ", " in p.time_steps else ""
        markers = () if p.seen is None else p.seen.sentences()
        for sentence in filter(None, (uneven, *p.notes, p.problem, *markers)):
            console.print(Text(f"{shown(p.file)}: {shown(sentence)}"))

"""Text tables whose columns only the documentation of their program explains: Kinovea, DeepLabCut, DICe, phyphox."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray


@dataclass(frozen=True)
class Tuning:
    """Times of frames."""

    #: [frames] largest distance of a time from the nearest frame
    #: convention: Half of what decides between two frames.
    off_frame: float = 0.25


TUNING = Tuning()


def read_kinovea(path: Path) -> tuple[pd.DataFrame, list[str]]:
    """Trajectories of Kinovea's text export, side by side, over frames; ValueError for times that are no numbers."""
    blocks: list[tuple[str, list[list[float]]]] = [("trajectory 1", [])]
    with path.open(encoding="utf-8-sig") as lines:
        for line in lines:
            cells = line.replace(",", ".").split()
            if blocks[-1][1] and (not cells or line.startswith("#")):
                blocks.append((f"trajectory {len(blocks) + 1}", []))
            if line.startswith("# "):
                blocks[-1] = (line[1:].strip(), [])
            elif cells and not line.startswith("#"):
                if len(cells) != 3 or ":" in cells[0]:
                    msg = f"{line.strip()!r} in a text file of Kinovea; export CSV by its Tools, Linear kinematics"
                    raise ValueError(msg)
                blocks[-1][1].append([float(cell) for cell in cells])
    parts = []
    names = [name for name, rows in blocks if rows]
    for number, (name, rows) in enumerate(blocks, 1):
        if rows:
            unique = name if names.count(name) == 1 else f"{name} {number}"
            columns = [f"{unique} X", f"{unique} Y"]
            parts.append(pd.DataFrame(rows, columns=["T", *columns]).set_index("T"))
    if not parts or max(len(part) for part in parts) < 2 or not all(part.index.is_unique for part in parts):
        msg = "a text file of Kinovea without trajectories of increasing times"
        raise ValueError(msg)
    table = pd.concat(parts, axis=1).sort_index()
    table.insert(0, "frame", _frames(table.index.to_numpy()))
    note = f"The table holds {len(parts)} trajectories of Kinovea, whose times are counted in frames."
    return table.reset_index(drop=True), [note]


def _frames(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Numbers of frames at times of Kinovea, the unit of which is a setting that the file does not state."""
    steps = (times - times[0]) / np.min(np.diff(times), initial=np.inf)
    if not np.max(np.abs(steps - np.round(steps))) <= TUNING.off_frame:
        msg = "times of Kinovea that do not increase from frame to frame"
        raise ValueError(msg)
    return np.asarray(np.round(steps), dtype=np.float64)


def read_deeplabcut(path: Path) -> tuple[pd.DataFrame, list[str]]:
    """Positions over frames in a table of DeepLabCut, LightningPose or movement, without their likelihood."""
    how = {"header": None, "compression": None, "index_col": False}
    heads = pd.read_csv(path, nrows=4, dtype=str, **how)
    first = [str(name) for name in heads[0]]
    levels = first.index("coords") + 1 if "coords" in first else 0
    if not levels:
        msg = f"rows {', '.join(first)} in a table of DeepLabCut, expected scorer, bodyparts and coords"
        raise ValueError(msg)
    values = pd.read_csv(path, skiprows=levels, **how)
    kept = [k for k in values.columns if k == 0 or heads.loc[levels - 1, k] != "likelihood"]
    names = [" ".join(map(str, heads.loc[1 : levels - 1, k])) for k in kept[1:]]
    if len(set(names)) < len(names):
        msg = "a table of DeepLabCut with two columns of one name"
        raise ValueError(msg)
    return values[kept].set_axis(["frame", *names], axis=1), ["The table holds the positions of DeepLabCut."]


# By the beginning of the file.
PROGRAMS: dict[str, Callable[[Path], tuple[pd.DataFrame, list[str]]]] = {
    "#Kinovea": read_kinovea,
    "scorer,": read_deeplabcut,
}


def of_motion(table: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """Columns proportional to the motion, of a solution of DICe or a table of phyphox, and a note on what was left out.

    Trajectories of Kinovea (``name/point/X``) are over frames, as in its text export. The modulus of the components in
    a table of phyphox is left out. ``SIGMA`` of DICe is the standard deviation of both displacements in px, -1 where
    the correlation failed (https://github.com/dicengine/dice/issues/133 and 218). ValueError for its solution of one
    frame at all points.
    """
    moduli = [name for name in table.columns if str(name).startswith("Absolute")]
    if moduli and any(" x (" in str(name) for name in table.columns):
        note = f"{', '.join(moduli)}, a modulus, is left out: its frequency is doubled."
        return table.drop(columns=moduli), [note]
    first, *others = map(str, table.columns)
    if others and first == "Time" and all(re.fullmatch(r".*/.*/[XY]", name) for name in others):
        times = pd.to_numeric(table[first]).to_numpy(dtype=np.float64)
        table = table.rename(columns={first: "frame"}).assign(frame=_frames(times))
        return table, ["The times of Kinovea, which have no unit, are counted in frames."]
    if not {"DISPLACEMENT_X", "DISPLACEMENT_Y", "SIGMA"} <= set(table.columns):
        return table, []
    if "FRAME" not in table.columns:
        msg = (
            "a solution of DICe with a row for each subset of one frame; let it write a file for each subset "
            "(separate_output_file_for_each_subset), with a row for each frame"
        )
        raise ValueError(msg)
    chosen = table[["DISPLACEMENT_X", "DISPLACEMENT_Y"]]
    failed = ~(table["SIGMA"] > 0.0)
    sd = pd.DataFrame({f"sd_{name}": table["SIGMA"] for name in chosen})
    columns = pd.concat([table["FRAME"], chosen.mask(failed), sd.mask(failed)], axis=1)
    note = f"Of the solution of DICe, the displacements are used; it failed in {int(failed.sum())} frame(s)."
    return columns, [note]

"""Registry of the columns of every table in OUT: each is declared once, with its name, unit, meaning and value.

The columns of a result stand next to its class, so that its data frame has them too: those of modes in
`modal_id/columns.py`, of tracks in `tracker/results.py`, of comparisons in `sim/comparison/results.py`, of the updating
in `sim/updating/update.py`, of damping laws in `sim/damping/evidence.py`. To add a column, write a `Column` into the
tuple of its table; CSV and docs/columns.md follow. The groups of `summary.json` are listed in `summary.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from modal_id import DAMPING, MODE_COLUMNS, RESPONSE_COLUMNS
from modal_id.modes import ALIAS_COLUMNS
from modalcam.tables.base import REGISTERED
from sim.comparison import COMPARISON_COLUMNS
from sim.damping import LAW_COLUMNS, LEFT_OUT_COLUMNS, PART_COLUMNS
from sim.updating import UPDATING_COLUMNS
from tracker import CORRELATION_COLUMN, TRACK_COLUMNS, Column

_NAMED = {one.name: one for one in (*COMPARISON_COLUMNS, *DAMPING)}
_MODE = _NAMED["mode"]
_RECORDING = Column("recording", "", "name of the recording")
_OF_MODE = (
    _RECORDING,
    replace(_MODE, text="number of the beam's mode; empty where unknown", get=lambda at: at.mode.number),
    Column("frequency_hz", "Hz", "as in `modes.csv`", lambda at: at.mode.frequency_hz),
)
# Of a `ShapePoint`.
SHAPE_COLUMNS = (
    *_OF_MODE,
    Column("marker", "", "name of the marker"),
    Column("position_mm", "mm", "distance from the clamp"),
    Column("shape", "1", "in-phase part of the shape, whose largest modulus is 1", lambda at: at.shape.real),
    Column("shape_out_of_phase", "1", "its out-of-phase part", lambda at: at.shape.imag),
    Column("shape_sd", "1", "standard deviation of each part"),
    Column("curvature_1_m2", "1/m²", "second derivative of `shape` by the distance from the clamp"),
    Column("curvature_sd_1_m2", "1/m²", "its standard deviation"),
)
# Of a `Participation`.
PARTICIPATION_COLUMNS = (
    *_OF_MODE,
    Column("channel", "", "name of the output"),
    Column(
        "participation",
        "unit",
        "relative motion in the mode per motion of the base far above the resonance; of a force, the modal constant",
    ),
    Column("participation_sd", "unit", "its standard deviation"),
    Column("unit", "", "unit of the participation"),
    Column(
        "modal_mass",
        "1/unit",
        "modal mass for a shape of 1 here, at the channel where the force acts; NaN for a base",
    ),
    Column("modal_mass_sd", "1/unit", "its standard deviation"),
)
# Of the drag in one recording: in summary.json only.
DRAG_COLUMNS = (
    Column("drag_coefficient", "1", "coefficient for the width of the beam"),
    Column("drag_coefficient_sd", "1", "its standard deviation; 0 for a given coefficient"),
    Column("drag_coefficient_q05", "1", "5 % quantile"),
    Column("drag_coefficient_q95", "1", "95 % quantile; the upper limit where no drag was detected"),
    replace(_NAMED["damping_ratio"], text="damping ratio at small amplitude"),
    _NAMED["damping_ratio_sd"],
)
TABLES: Mapping[str, tuple[Column, ...]] = {
    "tracks/*.csv": (*TRACK_COLUMNS, CORRELATION_COLUMN),
    "modes.csv": (_RECORDING, *MODE_COLUMNS),
    "aliases.csv": ALIAS_COLUMNS,
    "shapes.csv": SHAPE_COLUMNS,
    "response/*.csv": RESPONSE_COLUMNS,
    "participation.csv": PARTICIPATION_COLUMNS,
    "comparison.csv": COMPARISON_COLUMNS,
    "updating.csv": UPDATING_COLUMNS,
    "damping_laws.csv": LAW_COLUMNS,
    "damping_left_out.csv": LEFT_OUT_COLUMNS,
    "damping_parts.csv": PART_COLUMNS,
    "summary.json, drag": (_RECORDING, _MODE, *DRAG_COLUMNS),
}


def markdown() -> str:
    """The page docs/columns.md, which `python docs/columns.py` writes."""
    lines = [
        "# Columns of the tables",
        "",
        "[Files of a run](files.md) explains the tables. NaN, or an empty cell, is a value that is not known.",
    ]
    for table, columns in {**TABLES, **{name: one.columns for name, one in REGISTERED.items()}}.items():
        lines += ["", f"## `{table}`", "", "| column | unit | meaning |", "| --- | --- | --- |"]
        lines += [f"| `{one.name}` | {one.unit} | {one.text} |" for one in columns]
    return "\n".join(lines) + "\n"

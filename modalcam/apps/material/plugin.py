"""What this app adds to a run: the moduli of its bar, ``material.csv`` and a section of the report.

A plugin in the sense of `modalcam.plugins`; each process of a run loads this module, so that it imports little.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from modalcam.pipeline import AddedStage, Stage, register_stage
from modalcam.report.sections import Section, register_section
from modalcam.tables import register_table
from tracker import Column, Failure, table_row

if TYPE_CHECKING:
    from modalcam.apps.material.material import Material
    from modalcam.pipeline import Context, RunResult

MATERIAL_COLUMNS = (
    Column(
        "mode", "", "number of the bending mode, from 1; `torsion`; empty for a value that belongs to no mode"
    ),
    Column("frequency_hz", "Hz", "natural frequency of the specimen"),
    Column("frequency_sd_hz", "Hz", "its standard deviation; NaN if not given"),
    Column(
        "quantity",
        "",
        "`E`, `E_corrected` (without the effect of gravity, masses and clamp of `[beam]`), `G`, `poisson_ratio`, "
        "`loss_factor`; of the damping layer `E1` or `G1`, and `loss_factor_1`",
    ),
    Column("unit", "", "unit of the value, its standard deviation and interval"),
    Column("value", "unit", "by the equations, from the values as measured"),
    Column("sd", "unit", "standard deviation of the draws"),
    Column("q05", "unit", "5 % quantile of the draws"),
    Column("q95", "unit", "95 % quantile"),
    Column("largest_source", "", "measured value whose error has the largest share of the variance"),
    Column("share", "1", "that share"),
    Column("equations", "", "standards whose equations were used"),
    Column("remarks", "", "flags of the mode, joined by a vertical bar"),
)


def material_rows(found: Material) -> list[dict[str, Any]]:
    """Rows of ``material.csv``."""
    rows = (table_row(MATERIAL_COLUMNS, one) for one in found.values)
    return [row | {"mode": "" if row["mode"] is None else row["mode"]} for row in rows]


def compute(**given: Any) -> Material:
    """As `modalcam.apps.material.material`."""
    from modalcam.apps.material.material import material  # noqa: PLC0415 - workers only

    return material(**given)


def _inputs(_: Context, result: RunResult, __: object) -> Mapping[str, Any] | None:
    from modalcam.apps.material.specimen import of_run  # noqa: PLC0415 - of a run that is not up to date

    return of_run(result)


def _rows(result: RunResult) -> list[dict[str, Any]]:
    found = result.added.get("material")
    return material_rows(found) if found else []


def _view(result: RunResult, _: object) -> dict[str, Any] | None:
    return {"found": result.added["material"]} if "material" in result.added else None


_CODE = ("tracker", "modal_id", "sim", "modalcam.apps.material")
COMPUTING = Stage("moduli of the material", "material", _CODE, compute, lambda _, reason: Failure(reason))
register_stage(AddedStage(COMPUTING, "run", _inputs))
register_section(Section("material", "modalcam.apps.material", _view, title="Material"))
register_table(
    "material.csv",
    MATERIAL_COLUMNS,
    "only of a clamped bar with numbered modes: moduli and loss factors by the equations of ASTM E756",
    _rows,
)

"""The columns of ``material.csv``, for the registry of tables: a plugin in the sense of `modalcam.plugins`."""

from __future__ import annotations

from modalcam.tables import register_table
from tracker import Column

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
register_table("material.csv", MATERIAL_COLUMNS)

"""Identified modes as a workbook (.xlsx) for spreadsheets."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from modal_id import MODE_COLUMNS
from modalcam.common import shown
from modalcam.config import ExperimentConfig
from modalcam.pipeline import RunResult, Workspace, mode_table, replacing
from modalcam.tables.base import Output, Writer

if TYPE_CHECKING:
    import pandas as pd

_XML = '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n'
_OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
_TYPE = "application/vnd.openxmlformats-officedocument.spreadsheetml"
_XF = 'numFmtId="0" fontId="0" fillId="0" borderId="0"'
# The least that programs ask for: one font, the two fills that are reserved, one border, the style Normal.
_STYLES = (
    f'{_XML}<styleSheet xmlns="{_MAIN}"><fonts count="1"><font><sz val="11"/><name val="Calibri"/></font></fonts>'
    '<fills count="2"><fill><patternFill patternType="none"/></fill><fill><patternFill patternType="gray125"/></fill>'
    f'</fills><borders count="1"><border/></borders><cellStyleXfs count="1"><xf {_XF}/></cellStyleXfs>'
    f'<cellXfs count="1"><xf {_XF} xfId="0"/></cellXfs>'
    '<cellStyles count="1"><cellStyle name="Normal" xfId="0" builtinId="0"/></cellStyles></styleSheet>'
)
# The earliest that the format can state: the time of writing is no part of a result.
_DATE = (1980, 1, 1, 0, 0, 0)


def write_workbook(path: Path, sheets: dict[str, pd.DataFrame]) -> None:
    """Write tables as the sheets of a workbook (ECMA-376, part 1); the same tables give the same bytes.

    Numbers are numbers with all digits, missing ones are empty cells; texts are texts, never formulas.
    """
    names = {f"worksheets/sheet{k}.xml": name for k, name in enumerate(sheets, 1)}
    parts = {f"xl/{part}": _sheet(sheets[name]) for part, name in names.items()} | {"xl/styles.xml": _STYLES}
    kinds = {"xl/workbook.xml": "sheet.main", "xl/styles.xml": "styles"}
    overrides = "".join(
        f'<Override PartName="/{part}" ContentType="{_TYPE}.{kinds.get(part, "worksheet")}+xml"/>'
        for part in (*parts, "xl/workbook.xml")
    )
    listed = "".join(
        f'<sheet name={quoteattr(name)} sheetId="{k}" r:id="r{k}"/>'
        for k, name in enumerate(names.values(), 1)
    )
    parts |= {
        "[Content_Types].xml": f'{_XML}<Types xmlns="{_PACKAGE}/content-types"><Default Extension="rels" '
        f'ContentType="application/vnd.openxmlformats-package.relationships+xml"/>{overrides}</Types>',
        "_rels/.rels": _relations({"officeDocument": ["xl/workbook.xml"]}),
        "xl/_rels/workbook.xml.rels": _relations({"worksheet": list(names), "styles": ["styles.xml"]}),
        "xl/workbook.xml": f'{_XML}<workbook xmlns="{_MAIN}" xmlns:r="{_OFFICE}"><sheets>{listed}</sheets></workbook>',
    }
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as file:
        for name, text in parts.items():
            file.writestr(zipfile.ZipInfo(name, _DATE), text, zipfile.ZIP_DEFLATED)


def _relations(targets: dict[str, list[str]]) -> str:
    pairs = [(kind, target) for kind, found in targets.items() for target in found]
    listed = "".join(
        f'<Relationship Id="r{k}" Type="{_OFFICE}/{kind}" Target="{target}"/>'
        for k, (kind, target) in enumerate(pairs, 1)
    )
    return f'{_XML}<Relationships xmlns="{_PACKAGE}/relationships">{listed}</Relationships>'


def _sheet(table: pd.DataFrame) -> str:
    rows = chain([tuple(table.columns)], table.itertuples(index=False, name=None))
    filled = "".join(f"<row>{''.join(_cell(value) for value in row)}</row>" for row in rows)
    return f'{_XML}<worksheet xmlns="{_MAIN}"><sheetData>{filled}</sheetData></worksheet>'


def _cell(value: Any) -> str:
    if value == "":
        return "<c/>"
    if isinstance(value, (bool, np.bool_)):
        return f'<c t="b"><v>{int(value)}</v></c>'
    if isinstance(value, (int, float, np.number)):
        return f"<c><v>{float(value)!r}</v></c>" if np.isfinite(value) else "<c/>"
    return f'<c t="inlineStr"><is><t xml:space="preserve">{escape(shown(str(value)))}</t></is></c>'


def _outputs(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
    import pandas as pd  # noqa: PLC0415 - slow to import, and only a table that is written needs it

    columns = pd.DataFrame([{"column": c.name, "unit": c.unit, "meaning": c.text} for c in MODE_COLUMNS])
    yield Output(
        workspace.out / "modes.xlsx",
        result,
        lambda path: write_workbook(path, {"modes": mode_table(result.recordings), "columns": columns}),
    )


WORKBOOK = Writer(
    "workbook",
    "modes.xlsx",
    "the same as a workbook, with a second sheet on the units and meanings of the columns",
    _outputs,
)

"""What openpyxl reads from the workbook of modes, against the table that it is made from."""

import numpy as np
import pandas as pd
import pytest
from kit.runs import compared, paper_recordings, run_result

from modal_id import MODE_COLUMNS
from modalcam.config import ExperimentConfig
from modalcam.pipeline import Workspace
from modalcam.tables import WRITERS, write_workbook

openpyxl = pytest.importorskip("openpyxl", reason="the extra modalcam[xlsx] is not installed")


def values(sheet):
    return list(sheet.iter_rows(values_only=True))


def test_openpyxl_reads_the_modes_and_the_units_of_their_columns(tmp_path):
    result = run_result(compared(paper_recordings(2)))
    (output,) = WRITERS["workbook"].outputs(Workspace(tmp_path), result, ExperimentConfig())
    output.write(output.path)
    first = output.path.read_bytes()
    output.write(output.path)
    assert output.path.read_bytes() == first, "the same result gives the same bytes"
    book = openpyxl.load_workbook(tmp_path / "modes.xlsx")
    table = result.to_dataframe()
    head, *rows = values(book["modes"])
    assert list(head) == list(table.columns)
    # Empty cells are None: of missing numbers and of empty texts.
    expected = [[None if pd.isna(v) or v == "" else v for v in row] for row in table.itertuples(index=False)]
    assert [list(row) for row in rows] == expected
    assert len(rows) == 2
    assert values(book["columns"])[1:] == [(c.name, c.unit or None, c.text) for c in MODE_COLUMNS]


def test_texts_are_no_formulas_and_no_markup(tmp_path):
    texts = ["=1+1", "<b>&amp;", " a\nb ", "\x1b[0m", "\u03b6", ""]
    table = pd.DataFrame({"text": texts, "number": [1e-300, 0.1 + 0.2, np.nan, np.inf, -3.0, 2**53]})
    write_workbook(tmp_path / "a.xlsx", {'"<&': table})
    sheet = openpyxl.load_workbook(tmp_path / "a.xlsx")['"<&']
    assert "f" not in {cell.data_type for cell in sheet["A"]}, "openpyxl's type of a formula"
    _, *rows = values(sheet)
    assert [row[0] for row in rows][:5] == ["=1+1", "<b>&amp;", " a\\x0ab ", "\\x1b[0m", "\u03b6"]
    assert [row[1] for row in rows] == [1e-300, 0.1 + 0.2, None, None, -3.0, 2**53]

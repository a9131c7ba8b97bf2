"""The registry of output formats: a format of a plugin, a format without its library, the documentation."""

import importlib.util
import json
import runpy
import sys
from dataclasses import replace
from unittest import mock

import pytest
from kit.identified import identification_of
from kit.runs import beam_result, compared, paper_recordings, run_result
from support.paths import ROOT

import modal_id
import sim.comparison
from modalcam.common import InputError
from modalcam.config import ExperimentConfig
from modalcam.inputs import read_uff
from modalcam.pipeline import RecordingResult, RunResult, Workspace
from modalcam.plugins import load_apps
from modalcam.tables import (
    REGISTERED,
    TABLES,
    WRITERS,
    Output,
    Writer,
    outputs,
    register_table,
    register_writer,
    with_missing_formats,
)
from tracker import Column


@pytest.fixture
def result():
    recording = RecordingResult("take", "take.avi", "00", 2, identification=identification_of(fps=600.0))
    versions = (("modalcam", "0"),)
    return RunResult("folder", (recording,), None, (), "", versions, "modalcam run folder", 0)


@pytest.fixture
def writers(monkeypatch):
    copy = dict(WRITERS)
    monkeypatch.setattr("modalcam.tables.writers.WRITERS", copy)
    return copy


def write_all(out, result):
    for output in outputs(Workspace(out), result, ExperimentConfig()):
        output.write(output.path)


def count_outputs(workspace, result, config):
    def write(path):
        path.write_text(str(len(result.recordings)))

    yield Output(workspace.out / "count.txt", result, write)


TOY = Writer("count", "count.txt", "number of recordings", count_outputs)


def test_a_format_of_a_plugin_writes_its_file(tmp_path, result, writers):
    for library, extra in (("h5netcdf", "netcdf"), ("pyuff", "uff")):
        pytest.importorskip(library, reason=f"the extra modalcam[{extra}] is not installed")
    register_writer(TOY)
    write_all(tmp_path, result)
    assert (tmp_path / "count.txt").read_text() == "1"
    assert list(writers)[-1] == "count"
    names = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()}
    tables = "modes shapes comparison updating damping_laws damping_left_out damping_parts"
    expected = {f"{name}.csv" for name in tables.split()}
    expected |= {"modes.xlsx", "summary.json", "run.toml", "count.txt"}
    assert names == expected | {"posterior/take.nc", "universal/take.uff"}
    assert len(json.loads((tmp_path / "summary.json").read_text())["recordings"]) == 1


def test_a_registered_table_has_a_name_of_its_own_and_is_written_where_it_has_rows(tmp_path, result):
    load_apps("plugin")
    assert not REGISTERED.keys() & TABLES.keys()
    one = (Column("a", "", "one"),)
    with mock.patch.dict(REGISTERED):
        register_table("x.csv", one)
        with pytest.raises(ValueError, match="registered already"):
            register_table("x.csv", (Column("b", "", "another"),))
        register_table("y.csv", one, "names", lambda run: [{"a": each.name} for each in run.recordings])
        without = outputs(Workspace(tmp_path), replace(result, recordings=()), ExperimentConfig())
        assert not {"x.csv", "y.csv"} & {output.path.name for output in without}
        *_, last = outputs(Workspace(tmp_path), result, ExperimentConfig())
    last.write(tmp_path / "y.csv")
    assert ((tmp_path / "y.csv").read_text(), last.path.name, last.about) == ("a\ntake\n", "y.csv", "names")


def test_columns_of_other_tables_are_found_by_their_names(monkeypatch):
    """A column that is put before another must not take its place in the tables that share it."""
    tables = runpy.run_path(str(ROOT / "modalcam/tables/columns.py"))["TABLES"]
    monkeypatch.setattr("sim.comparison.COMPARISON_COLUMNS", sim.comparison.COMPARISON_COLUMNS[::-1])
    monkeypatch.setattr("modal_id.DAMPING", modal_id.DAMPING[::-1])
    turned = runpy.run_path(str(ROOT / "modalcam/tables/columns.py"))["TABLES"]
    for table in ("shapes.csv", "summary.json, drag"):
        assert [(c.name, c.text) for c in turned[table]] == [(c.name, c.text) for c in tables[table]]


def test_tables_have_the_same_columns_with_and_without_rows(tmp_path):
    full = run_result(compared(paper_recordings(2)), beam=beam_result(elements=6))
    names = ("modes", "comparison", "updating", "damping_laws", "damping_left_out", "damping_parts")
    for out, result in (("full", full), ("empty", run_result())):
        for name in names:
            for output in WRITERS[name].outputs(Workspace(tmp_path / out), result, ExperimentConfig()):
                output.write(output.path)
    for name in names:
        header, *rows = (tmp_path / "full" / f"{name}.csv").read_text().splitlines()
        assert rows
        assert "NaN" not in rows[0].split(",")[:2]
        assert (tmp_path / "empty" / f"{name}.csv").read_text() == f"{header}\n"


def test_names_are_unique(writers):
    register_writer(TOY)
    register_writer(TOY)
    with pytest.raises(ValueError, match="'count' is registered already"):
        register_writer(Writer("count", "other.txt", "something else", count_outputs))


def test_a_format_without_its_library_is_skipped_with_a_note(tmp_path, result, writers, monkeypatch):
    pytest.importorskip("h5netcdf", reason="the extra modalcam[netcdf] is not installed")
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "pyuff" else find(name))
    write_all(tmp_path, result)
    assert not (tmp_path / "universal").exists()
    assert (tmp_path / "posterior" / "take.nc").exists()
    (note,) = with_missing_formats(result).not_done
    told = "universal/<recording>.uff was not written: pyuff not installed; install with pip install pyuff."
    assert note == told


def test_reading_a_universal_file_names_the_missing_library(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyuff", None)
    with pytest.raises(InputError, match="pip install pyuff"):
        read_uff(tmp_path / "a.uff", name="a", unit="1")


@pytest.mark.parametrize("writer", WRITERS.values(), ids=list(WRITERS))
def test_the_documentation_lists_every_format(writer):
    page = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    assert f"| `{writer.files}` | {writer.description} |" in page

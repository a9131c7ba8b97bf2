import json
import os

import pytest
from kit import attacks

from modalcam.common import InputError, OutputError
from modalcam.config import ExperimentConfig
from modalcam.pipeline import Outputs, RememberedHashes, RunRecord, Source, Workspace, replacing, write_text


def test_a_run_record_is_read_back(tmp_path):
    workspace = Workspace(tmp_path / "out")
    workspace.prepare(inputs=None, force=False)
    record = RunRecord("f", (Source("a", "a.avi", "00", 3),), ExperimentConfig(), 5, "run f", ("note",))
    workspace.write_record(record)
    assert workspace.read_record() == record


def test_missing_and_damaged_results_are_reported(tmp_path):
    workspace = Workspace(tmp_path / "out")
    with pytest.raises(InputError, match="modalcam run"):
        workspace.read_record()
    workspace.prepare(inputs=None, force=False)
    (tmp_path / "out" / "state" / "run.json").write_text("{")
    with pytest.raises(InputError, match="damaged"):
        workspace.read_record()
    (tmp_path / "out" / "state" / "run.json").write_text('{"notes": [], "skipped": [], "versions": []}')
    with pytest.raises(InputError, match="damaged"):
        workspace.read_state()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("folder", None),
        ("command_line", 5),
        ("notes", [1]),
        ("versions", [["numpy", 2]]),
        ("results", {"a": {"modes": 5}}),
        ("results", ["a"]),
        ("seed", "5"),
        ("sources", [{"name": [], "file": "a.avi", "sha256": "", "mode": 1}]),
        ("sources", [{"name": "a", "file": "a.avi", "sha256": "", "mode": "1"}]),
    ],
)
def test_a_record_whose_fields_are_of_other_types_is_damaged(tmp_path, field, value):
    workspace = Workspace(tmp_path)
    workspace.write_record(RunRecord("f", (), ExperimentConfig(), 5, "modalcam run f"))
    path = tmp_path / "state" / "run.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {field: value}))
    with pytest.raises(InputError, match="damaged"):
        workspace.read_record()


@pytest.mark.parametrize("text", ["[" * 100_000, "[]", "5", '{"a": 1', "fifo"])
def test_records_of_other_content_are_taken_for_damaged(tmp_path, text):
    workspace = Workspace(tmp_path)
    (tmp_path / "state").mkdir()
    for name in ("run.json", "outputs.json", "inputs.json"):
        if text == "fifo":
            os.mkfifo(tmp_path / "state" / name)
        else:
            (tmp_path / "state" / name).write_text(text)
    with pytest.raises(InputError, match="damaged"):
        workspace.read_state()
    assert Outputs(workspace).intact() == {}
    assert RememberedHashes(workspace.hashes).get(tmp_path / "a.avi") is None


@pytest.mark.parametrize(
    "name", ["state", "state/figures", "state/lock", "posterior", "tracks", "plots/of a plugin"]
)
def test_nothing_is_written_through_a_link_in_the_folder(tmp_path, name):
    victim = tmp_path / "victim"
    (victim / "state").mkdir(parents=True)
    for path in (victim / "mine.npz", victim / ".tmp-1-mine"):
        path.write_text("mine")
    workspace = Workspace(tmp_path / "out")
    if name != "state":
        workspace.prepare(inputs=None, force=False)
    (tmp_path / "out" / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / "out" / name).symlink_to(victim / "mine.npz" if name == "state/lock" else victim)
    before = attacks.content(victim)
    with pytest.raises(OutputError, match="found a link"), workspace.locked():
        pass
    assert attacks.content(victim) == before


def test_results_are_not_written_among_recordings_or_over_other_files(tmp_path):
    with pytest.raises(InputError, match="never written among the recordings"):
        Workspace(tmp_path).prepare(inputs=tmp_path, force=True)
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(InputError, match="--force"):
        Workspace(tmp_path).prepare(inputs=None, force=False)
    with pytest.raises(InputError, match="found a file"):
        Workspace(tmp_path / "thesis.tex").prepare(inputs=None, force=False)
    Workspace(tmp_path).prepare(inputs=None, force=True)
    assert (tmp_path / "thesis.tex").read_text() == "x"


def test_only_one_run_writes_to_a_folder(tmp_path):
    workspace = Workspace(tmp_path / "out")
    workspace.prepare(inputs=None, force=False)
    with workspace.locked(), pytest.raises(InputError, match="another run"), workspace.locked():
        pass
    with workspace.locked():
        pass


def test_what_a_killed_run_left_is_removed_and_nothing_else(tmp_path):
    workspace = Workspace(tmp_path / "out")
    workspace.prepare(inputs=None, force=False)
    partial = tmp_path / "out" / "state" / "figures" / ".tmp-123-a.npz"
    other = tmp_path / "out" / ".tmp-notes.txt"
    for path in (partial, other):
        path.parent.mkdir(exist_ok=True)
        path.write_text("x")
    with workspace.locked():
        assert not partial.exists()
        assert other.exists()


def test_a_file_is_replaced_completely_or_not_at_all(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")

    def fail():
        with replacing(path) as temporary:
            temporary.write_text("half")
            msg = "power cut"
            raise RuntimeError(msg)

    with pytest.raises(RuntimeError, match="power cut"):
        fail()
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_files_of_earlier_runs_leave_the_folder_unless_somebody_changed_them(tmp_path):
    workspace = Workspace(tmp_path / "out")
    workspace.prepare(inputs=None, force=False)
    victim = tmp_path / "victim.txt"
    write_text(victim, "a")
    first = Outputs(workspace)
    paths = [workspace.tracks(name) for name in "abc"]
    for path in paths:
        first.write(path, "key", lambda path: write_text(path, "a"))
    first.finish(paths)
    planted = json.loads(workspace.written.read_text())
    for name in ("../victim.txt", "tracks/../../victim.txt", str(victim)):
        planted[name] = planted["tracks/a.csv"]
    workspace.written.write_text(json.dumps(planted))
    paths[1].write_text("a note of the user")
    for force in (False, True):
        again = Outputs(workspace, force=force)
        assert again.write(paths[0], "key", lambda path: write_text(path, "a")) is not force
        again.finish(paths[:1])
    assert sorted(path.name for path in (tmp_path / "out" / "tracks").iterdir()) == ["a.csv", "b.csv"]
    assert victim.read_text() == "a"


def test_names_of_a_record_do_not_lead_out_of_the_folder(tmp_path):
    workspace = Workspace(tmp_path)
    for path in (workspace.tracks, workspace.posterior, workspace.universal):
        with pytest.raises(InputError, match="expected the name of a recording"):
            path("../../victim")
    with pytest.raises(InputError, match="expected the name of a recording"):
        workspace.state("a/b", "modes")

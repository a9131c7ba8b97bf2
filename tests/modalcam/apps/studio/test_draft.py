"""The draft of a configuration: what is edited, what stays byte for byte, undo, drafts of earlier sessions, saving."""

import json
import tomllib

import pytest
from support.paths import SAMPLES

from modalcam.apps.studio import Draft, with_options_of, with_section
from modalcam.common import ConfigError, OutputError
from modalcam.config import load_config

COMMENTED = """\
# heading of the lab
[camera]          # the camera
fps = 1000.0      # measured by the strobe

[[recordings]]
file = "a.avi"    # first take
mode = 1

# the second one
[[recordings]]
file = 'b "quoted".avi'
"""


def new_draft(tmp_path, text=None, store=True):
    path = tmp_path / "videos" / "experiment.toml"
    path.parent.mkdir(exist_ok=True)
    if text is not None:
        path.write_bytes(text.encode())
    return Draft(path, tmp_path / "out" / "draft.json" if store else None)


def changed_lines(before, after):
    """Lines taken away and added; all others must be the same, in the same order."""
    old, new = before.splitlines(keepends=True), after.splitlines(keepends=True)
    kept = [line for line in old if line in new]
    assert kept == [line for line in new if line in old]
    return [line for line in old if line not in new], [line for line in new if line not in old]


def test_a_changed_value_keeps_every_other_byte():
    assert changed_lines(COMMENTED, with_section(COMMENTED, "camera", {"fps": 500})) == (
        ["fps = 1000.0      # measured by the strobe\n"],
        ["fps = 500      # measured by the strobe\n"],
    )


def test_options_are_added_to_the_entry_of_the_file():
    text = with_options_of(COMMENTED, 'b "quoted".avi', {"kind": "patch", "points_px": [[1.5, 2.0]]})
    assert changed_lines(COMMENTED, text) == ([], ['kind = "patch"\n', "points_px = [[1.5, 2.0]]\n"])
    entries = tomllib.loads(text)["recordings"]
    assert entries[1] == {"file": 'b "quoted".avi', "kind": "patch", "points_px": [[1.5, 2.0]]}
    assert entries[0] == {"file": "a.avi", "mode": 1}


@pytest.mark.parametrize(
    "file", ["new.avi", 'x"\n[beam]\nlength_mm = 1.avi', "[[recordings]]", "a\\b 'c'.avi", "ü.avi"]
)
def test_an_entry_is_added_for_any_name(file):
    text = with_options_of(COMMENTED, file, {"fps": 250})
    assert text.startswith(COMMENTED)
    assert tomllib.loads(text)["recordings"][2] == {"file": file, "fps": 250}
    assert set(tomllib.loads(text)) == {"camera", "recordings"}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "# only a comment\n",
        'camera.fps = 5\nrecordings = [{file = "a.avi", mode = 2}]\n',
        "[camera]\r\nfps = 5\r\n# windows\r\n",
        '[[recordings]]\nfile = "a.avi"\n[beam]\nlength_mm = 3.0\n',
    ],
)
def test_every_form_of_toml_can_be_edited(text):
    edited = with_options_of(with_section(text, "camera", {"fps": 7}), "z.avi", {"mode": 1})
    before, after = tomllib.loads(text), tomllib.loads(edited)
    assert after["camera"] == before.get("camera", {}) | {"fps": 7}
    assert after["recordings"] == [*before.get("recordings", ()), {"file": "z.avi", "mode": 1}]
    assert after.get("beam") == before.get("beam")
    assert edited.count("\r\n") == text.count("\r\n")


def test_the_samples_keep_their_comments(tmp_path):
    text = (SAMPLES / "experiment.toml").read_text()
    draft = new_draft(tmp_path, text)
    draft.set_for("mode4.avi", {"onset_s": 1.25})
    removed, added = changed_lines(text, draft.text)
    assert (removed, added) == ([], ["onset_s = 1.25\n"])


def test_an_option_is_changed_where_it_is_given(tmp_path):
    alone = new_draft(tmp_path, "[camera]\nfps = 100\n")
    alone.set_for("a.avi", {"fps": 200, "mode": 3})
    assert tomllib.loads(alone.text) == {"camera": {"fps": 200}, "recordings": [{"file": "a.avi", "mode": 3}]}
    two = new_draft(tmp_path, '[camera]\nfps = 100\n[[recordings]]\nfile = "b.avi"\n', store=False)
    two.set_for("a.avi", {"fps": 200})
    assert two.recording("a.avi").fps == 200
    assert two.recording("b.avi").fps == 100


def test_what_is_not_valid_is_refused_and_changes_nothing(tmp_path):
    draft = new_draft(tmp_path, COMMENTED)
    with pytest.raises(ConfigError, match="fps: expected frames per second"):
        draft.set_section("camera", {"fps": "fast"})
    with pytest.raises(ConfigError, match="unknown key"):
        draft.set_for("a.avi", {"colour": "red"})
    assert draft.text == COMMENTED
    assert not draft.can_undo


def test_undo_goes_back_step_by_step(tmp_path):
    draft = new_draft(tmp_path, COMMENTED)
    for rate in (1, 2, 3):
        draft.set_section("camera", {"fps": rate})
    draft.undo()
    assert draft.config.camera.fps == 2
    draft.undo()
    draft.undo()
    assert draft.text == COMMENTED
    draft.undo()
    assert draft.text == COMMENTED


def test_the_difference_names_the_changed_lines(tmp_path):
    draft = new_draft(tmp_path, COMMENTED)
    assert draft.difference() == ""
    draft.set_section("camera", {"fps": 500})
    changed = [x for x in draft.difference().splitlines() if x[:1] in "+-" and x[:3] not in ("---", "+++")]
    note = "      # measured by the strobe"
    assert changed == [f"-fps = 1000.0{note}", f"+fps = 500{note}"]


@pytest.mark.parametrize("head", [b"", b"\xef\xbb\xbf"])
def test_saving_replaces_the_file_and_keeps_its_form(tmp_path, head):
    path = tmp_path / "experiment.toml"
    path.write_bytes(head + COMMENTED.replace("\n", "\r\n").encode())
    draft = Draft(path, tmp_path / "draft.json")
    draft.set_section("camera", {"fps": 500})
    assert (tmp_path / "draft.json").exists()
    draft.save()
    expected = COMMENTED.replace("fps = 1000.0 ", "fps = 500 ").replace("\n", "\r\n").encode()
    assert path.read_bytes() == head + expected
    assert not draft.is_changed
    assert sorted(p.name for p in tmp_path.iterdir()) == ["experiment.toml"]
    assert load_config(path).camera.fps == 500


def test_a_draft_outlives_its_session(tmp_path):
    new_draft(tmp_path, COMMENTED).set_section("camera", {"fps": 500})
    again = new_draft(tmp_path)
    assert again.config.camera.fps == 500
    assert "restored" in again.notes[0]
    again.undo()
    assert again.text == COMMENTED
    assert not (tmp_path / "out" / "draft.json").exists()


@pytest.mark.parametrize("damage", ["changed file", "no json", "other json", "invalid"])
def test_a_draft_that_does_not_fit_is_kept_aside(tmp_path, damage):
    new_draft(tmp_path, COMMENTED).set_section("camera", {"fps": 500})
    store, path = tmp_path / "out" / "draft.json", tmp_path / "videos" / "experiment.toml"
    if damage == "changed file":
        path.write_text(COMMENTED + "# more\n")
    elif damage == "invalid":
        store.write_text(json.dumps(json.loads(store.read_text()) | {"text": "[camera]\nfps = -1\n"}))
    else:
        store.write_text("{" if damage == "no json" else "[1]")
    kept = store.read_bytes()
    again = new_draft(tmp_path)
    assert again.config.camera.fps == 1000
    assert "not used" in again.notes[0]
    assert (tmp_path / "out" / "draft.old.json").read_bytes() == kept


def test_a_file_that_another_program_changed_is_not_overwritten(tmp_path):
    draft = new_draft(tmp_path, COMMENTED)
    draft.set_section("camera", {"fps": 500})
    draft.path.write_text(COMMENTED + "# by hand\n")
    with pytest.raises(OutputError, match="changed by another program"):
        draft.save()
    assert draft.path.read_text() == COMMENTED + "# by hand\n"
    draft.begin_again()
    assert draft.text.endswith("# by hand\n")
    draft.undo()
    assert draft.config.camera.fps == 500


def test_an_invalid_file_is_named_at_the_start(tmp_path):
    with pytest.raises(ConfigError, match=r"experiment\.toml: line 2: .*text editor"):
        new_draft(tmp_path, "[camera]\nfsp = 3\n")


def test_an_option_is_added_before_the_comments_of_the_next_recording(tmp_path):
    """Comments at the end of a table stand before the one that follows, and describe it."""
    path = tmp_path / "experiment.toml"
    text = """\
[[recordings]]
file = "a.avi"  # first
mode = 1

# hit twice
[[recordings]]
file = "b.avi"
# the end
"""
    path.write_text(text)
    draft = Draft(path)
    draft.set_for("a.avi", {"fps": 100, "exposure_s": 0.1})
    draft.set_for("b.avi", {"fps": 200})
    added = text.replace("mode = 1\n", "mode = 1\nfps = 100\nexposure_s = 0.1\n")
    assert draft.text == added.replace('"b.avi"\n', '"b.avi"\nfps = 200\n')


BEAM = {"length_mm": 500.0, "width_mm": 5.0, "thickness_mm": 0.5}


def test_a_beam_is_set_at_once_and_removed_with_what_is_in_it(tmp_path):
    draft = new_draft(tmp_path, COMMENTED + "\n[[beam.point_masses]]\nposition_mm = 9.0\nmass_g = 1.0\n")
    draft.set_section("beam", BEAM | {"orientation": "angled", "angle_deg": 0.0})
    assert draft.config.beam.angle_deg == 0.0
    with pytest.raises(ConfigError, match="if thickness_mm is in metres"):
        draft.set_section("beam", {"thickness_mm": 0.0005})
    draft.set_section("beam", {"orientation": "standing", "angle_deg": None})
    assert [mass.mass_g for mass in draft.config.beam.point_masses] == [1.0]
    draft.undo()
    draft.undo()
    draft.set_section("beam", None)
    assert draft.config.beam is None
    assert draft.text.rstrip() == COMMENTED.rstrip()

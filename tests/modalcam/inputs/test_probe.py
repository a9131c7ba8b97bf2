"""Markers that `probe` reports, against the centres that were rendered."""

import json
import tomllib
from dataclasses import asdict

import numpy as np
import pytest
from kit.scenes import FPS, Recording

from modalcam.config import ExperimentConfig
from modalcam.inputs import Found, probe_folder, probe_recordings, starter_config
from sim.render import write_video
from tracker.markers import aruco

SCENE = {"frames": 16, "markers": 3, "width_px": 240, "height_px": 90, "amplitude_px": 1.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Dots, codes and an empty background."""
    made = tmp_path_factory.mktemp("films")
    for kind in ("blob", "aruco"):
        Recording(kind, dictionary="DICT_5X5_50", **SCENE).write(made / f"{kind}.mkv")
    write_video(made / "empty.mkv", iter(np.full((16, 90, 240), 120, np.uint8)), fps_container=FPS)
    return made


@pytest.fixture(scope="module")
def probes(folder):
    return {p.file: p for p in probe_folder(folder, follow_symlinks=False)}


@pytest.mark.parametrize(("kind", "size_px"), [("blob", 12.0), ("aruco", 24.0)])
def test_markers_are_where_they_were_rendered(probes, kind, size_px):
    seen = probes[f"{kind}.mkv"].seen
    assert seen.kind == kind
    truth = Recording(kind, **SCENE).truth_px()
    found = np.array([(m.x_px, m.y_px) for m in seen.markers])
    nearest = np.hypot(*np.moveaxis(truth[:, :, None] - found, -1, 0)).min(axis=(0, 1))
    assert len(seen.markers) == 3
    assert np.all(nearest < 1.0), "detection is accurate to a pixel, in some of the first frames"
    # The first estimate of a blurred outline.
    assert [m.size_px for m in seen.markers] == pytest.approx([size_px] * 3, rel=0.15)


@pytest.mark.parametrize("kind", ["blob", "aruco"])
def test_markers_that_move_are_those_of_one_frame(tmp_path, kind, monkeypatch):
    """Each is detected where it is sharpest, up to 6 px away; the places shown are those of the first frame."""
    # All families are searched for in the films of `folder`, and in tracker/markers/test_detection.py.
    own = tuple(family for family in aruco.FAMILIES if "DICT_4X4_50" in family)
    monkeypatch.setattr(aruco, "FAMILIES", own)
    scene = Recording(kind, frames=32, markers=3, width_px=240, height_px=90, amplitude_px=6.0)
    scene.write(tmp_path / "film.mkv")
    (probe,) = probe_folder(tmp_path, follow_symlinks=False)
    assert [m.frame for m in probe.seen.markers] == [0, 0, 0]
    places = np.array([(m.x_px, m.y_px) for m in probe.seen.markers])
    assert np.hypot(*(places - scene.truth_px()[0]).T).max() < 1.0, "detection is accurate to a pixel"


def test_codes_have_dictionary_and_number(probes):
    seen = probes["aruco.mkv"].seen
    assert [m.code for m in seen.markers] == [f"DICT_5X5_50 {k}" for k in range(3)]
    first = seen.sentences()[0]
    assert first.startswith("3 markers of kind aruco, DICT_5X5_50 0, 1, 2, of 2")
    assert f"id1 ({seen.markers[1].x_px:.0f}, {seen.markers[1].y_px:.0f})" in first


def test_a_film_without_markers_says_what_was_sought(probes):
    probe = probes["empty.mkv"]
    assert probe.problem == "", "the film itself can be read"
    assert (probe.seen.kind, probe.seen.markers) == ("", ())
    first = probe.seen.sentences()[0]
    assert first.startswith("no markers: no ArUco marker of any dictionary was detected")
    assert "no round dot" in first
    assert first.endswith("`modalcam pick`")
    json.dumps(asdict(probe), allow_nan=False)


def test_a_wrong_number_of_dots_shows_the_candidates(folder):
    config = ExperimentConfig(markers={"kind": "blob", "positions_mm": [0.0, 10.0, 20.0, 30.0]})
    found = Found("blob", "blob.mkv", folder / "blob.mkv")
    (probe,) = probe_recordings([found], config)
    assert "4" in probe.seen.reason
    assert len(probe.seen.candidates_px) == 3
    assert "; candidates at (" in probe.seen.sentences()[0]


def test_the_starter_file_says_which_markers_were_seen(folder, probes):
    text = starter_config(folder, each=lambda _, tasks: [probes[found.file] for found, _ in tasks])
    assert [r["file"] for r in tomllib.loads(text)["recordings"]] == ["aruco.mkv", "blob.mkv", "empty.mkv"]
    entry = text[text.index('file = "aruco.mkv"') : text.index('file = "blob.mkv"')]
    assert "# 3 markers of kind blob, of 1" in entry, "the comment stands above the entry"
    assert max(map(len, entry.splitlines())) <= 120

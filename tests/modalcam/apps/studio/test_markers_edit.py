"""What clicks write into the configuration, and what is drawn over a frame."""

import re
import tomllib
from xml.etree import ElementTree as ET

import pytest

from modalcam.apps.studio import DetectedMarker, Draft, in_image, marked, markers_text, overlay, trail
from modalcam.apps.studio import markers as edit
from modalcam.apps.studio import on_canvas as to_canvas
from modalcam.common import ModalcamError
from modalcam.config import RecordingConfig


@pytest.fixture
def draft(tmp_path):
    return Draft(tmp_path / "experiment.toml")


def entry(draft):
    return tomllib.loads(draft.text)["recordings"][0]


def test_points_are_added_moved_and_deleted_with_their_positions(draft):
    edit.add_point(draft, "a.avi", (10.0, 20.0))
    edit.add_point(draft, "a.avi", (30.5, 40.0))
    edit.move_point(draft, "a.avi", 0, (11.0, 21.0))
    edit.set_positions(draft, "a.avi", "0, 90.5")
    points = [[11.0, 21.0], [30.5, 40.0]]
    expected = {"file": "a.avi", "kind": "patch", "points_px": points, "positions_mm": [0.0, 90.5]}
    assert entry(draft) == expected
    edit.delete_point(draft, "a.avi", 0)
    assert entry(draft) == expected | {"points_px": [[30.5, 40.0]], "positions_mm": [90.5]}
    edit.delete_point(draft, "a.avi", 0)
    assert entry(draft) == {"file": "a.avi"}
    for _ in range(6):
        draft.undo()
    assert draft.text == ""


def test_a_marker_moved_earlier_takes_its_position_along(draft):
    for at in ((10.0, 20.0), (30.0, 40.0), (50.0, 60.0)):
        edit.add_point(draft, "a.avi", at)
    edit.move_earlier(draft, "a.avi", 2)
    assert entry(draft)["points_px"] == [[10.0, 20.0], [50.0, 60.0], [30.0, 40.0]]
    assert "positions_mm" not in entry(draft)
    edit.set_positions(draft, "a.avi", "5 90 50")
    edit.move_earlier(draft, "a.avi", 1)
    assert entry(draft)["points_px"] == [[50.0, 60.0], [10.0, 20.0], [30.0, 40.0]]
    assert entry(draft)["positions_mm"] == [90.0, 5.0, 50.0]


def test_names_follow_their_patches(draft):
    for at in ((10.0, 20.0), (30.0, 40.0), (50.0, 60.0)):
        edit.add_point(draft, "a.avi", at)
    assert "names" not in entry(draft), "m1, m2, m3 need not be written"
    edit.rename_point(draft, "a.avi", 1, " left weight ")
    assert entry(draft)["names"] == ["m1", "left weight", "m3"]
    assert ">left weight</text>" in overlay(draft.recording("a.avi"))
    edit.move_earlier(draft, "a.avi", 1)
    assert entry(draft)["names"] == ["left weight", "m2", "m3"]
    edit.add_point(draft, "a.avi", (70.0, 80.0))
    assert entry(draft)["names"] == ["left weight", "m2", "m3", "m4"]
    edit.delete_point(draft, "a.avi", 1)
    assert entry(draft)["names"] == ["left weight", "m2", "m3"]
    edit.rename_point(draft, "a.avi", 0, "")
    assert "names" not in entry(draft)
    with pytest.raises(ModalcamError, match="must differ"):
        edit.rename_point(draft, "a.avi", 0, "m2")
    with pytest.raises(ModalcamError, match="which begins with a letter"):
        edit.rename_point(draft, "a.avi", 0, "=HYPERLINK(1)")


DETECTED = (
    DetectedMarker("id3", 100.2, 80.9, 20.0),
    DetectedMarker("id5", 20.0, 20.0, 8.0),
    DetectedMarker("id9", 60.0, 50.0, 10.0),
)


def test_markers_are_left_out_with_their_names_and_positions(draft):
    edit.leave_out(draft, "a.avi", DETECTED, {0, 1})
    regions = [[[82.0, 63.0], [118.0, 99.0]], [[11.0, 11.0], [29.0, 29.0]]]
    assert entry(draft) == {"file": "a.avi", "leave_out_px": regions}
    draft.undo()
    assert draft.text == "", "one step"
    edit.set_positions(draft, "a.avi", "10 50 90")
    edit.rename_detected(draft, "a.avi", DETECTED, 2, "tip")
    edit.leave_out(draft, "a.avi", DETECTED, {1})
    assert entry(draft)["names"] == ["id3", "tip"]
    assert entry(draft)["positions_mm"] == [10.0, 90.0]


def test_detected_markers_are_named_by_the_user_or_by_their_kind(draft):
    edit.rename_detected(draft, "a.avi", DETECTED, 1, " root ")
    assert entry(draft)["names"] == ["id3", "root", "id9"]
    assert edit.detected_names(draft.recording("a.avi"), DETECTED) == ("id3", "root", "id9")
    assert edit.detected_names(draft.recording("a.avi"), DETECTED[:2]) == ("id3", "id5"), "names of others"
    with pytest.raises(ModalcamError, match="must differ"):
        edit.rename_detected(draft, "a.avi", DETECTED, 0, "root")
    edit.rename_detected(draft, "a.avi", DETECTED, 1, "")
    assert entry(draft) == {"file": "a.avi"}


def test_regions_are_added_and_deleted(draft):
    edit.add_region(draft, "a.avi", (50.0, 10.0), (20.0, 40.0))
    edit.leave_out(draft, "a.avi", DETECTED, {0})
    assert entry(draft)["leave_out_px"] == [[[20.0, 10.0], [50.0, 40.0]], [[82.0, 63.0], [118.0, 99.0]]]
    edit.delete_region(draft, "a.avi", 0)
    edit.delete_region(draft, "a.avi", 0)
    assert entry(draft) == {"file": "a.avi"}
    with pytest.raises(ModalcamError, match="choose opposite corners"):
        edit.add_region(draft, "a.avi", (50.0, 10.0), (50.2, 40.0))


def test_a_line_and_a_scale_from_two_clicks_each(draft):
    edit.set_line(draft, "a.avi", (10.0, 20.0), (10.0, 220.0))
    edit.set_scale(draft, "a.avi", ((0.0, 0.0), (30.0, 40.0)), 25.0)
    line = {"kind": "line", "line_px": [[10.0, 20.0], [10.0, 220.0]]}
    assert entry(draft) == {"file": "a.avi", "mm_per_px": 0.5} | line
    with pytest.raises(ModalcamError, match="two that are far apart"):
        edit.set_scale(draft, "a.avi", ((3.0, 3.0), (3.5, 3.0)), 25.0)


def test_positions_that_are_no_numbers_are_refused(draft):
    with pytest.raises(ModalcamError, match="expected distances from the clamp"):
        edit.set_positions(draft, "a.avi", "0 ten")


@pytest.mark.parametrize(
    ("text", "value"),
    [(" 1000 ", 1000), ("59.94", 59.94), ("30000/1001", "30000/1001"), ("", None), ("x", "x")],
)
def test_rates_are_written_as_typed(text, value):
    assert edit.parse_rate(text) == value
    assert type(edit.parse_rate(text)) is type(value)


def test_the_nearest_point_is_taken_hold_of():
    points = ((0.0, 0.0), (10.0, 0.0))
    assert edit.nearest_point(points, (8.0, 1.0), 6.0) == 1
    assert edit.nearest_point(points, (5.0, 50.0), 6.0) is None
    assert edit.nearest_point((), (0.0, 0.0), 6.0) is None


def test_pixel_centres_are_at_integers():
    """The middle of the first pixel is half a pixel from the corner of the picture."""
    assert in_image(0.5, 0.5) == (0.0, 0.0)
    assert to_canvas(*in_image(12.5, 3.5)) == (12.5, 3.5)


def shapes(content):
    return [(e.tag, e.attrib.get("class")) for e in ET.fromstring(f"<svg>{content}</svg>")]  # noqa: S314 - made here


def test_the_overlay_shows_the_kind_that_is_followed():
    patches = RecordingConfig(file="a", kind="patch", points_px=((5.0, 6.0),), size_px=41.0)
    assert shapes(overlay(patches)) == [("rect", "window"), ("circle", "dot point"), ("text", "above")]
    assert 'width="41.00"' in overlay(patches)
    round_ = patches.model_copy(update={"patch_shape": "round"})
    assert shapes(overlay(round_))[0] == ("circle", "window")
    ends = ((0.0, 0.0), (0.0, 100.0))
    line = RecordingConfig(file="a", kind="line", line_px=ends, stations=11, points_px=((1, 2),))
    drawn = re.findall(r'station" cx="([\d.]+)" cy="([\d.]+)"', overlay(line))
    assert [float(y) for _, y in drawn] == [0.5 + 10.0 * k for k in range(11)]
    assert "window" not in overlay(line)


def test_the_overlay_shows_positions_and_regions():
    """A region from pixel 10 to pixel 19 covers ten pixels from the corner of the first one."""
    left_out = ((19.0, 4.0), (10.0, 8.0))
    patch = {"kind": "patch", "points_px": ((5.0, 6.0),), "positions_mm": (90.5,)}
    recording = RecordingConfig(file="a", leave_out_px=(left_out,), **patch)
    region, *_, name = ET.fromstring(f"<svg>{overlay(recording)}</svg>")  # noqa: S314 - made here
    place = {"x": "10.00", "y": "4.00", "width": "10.00", "height": "5.00"}
    assert region.attrib == {"class": "left-out"} | place
    assert name.text == "m1, 90.5 mm"


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "auto"),
        ({"kind": "aruco"}, "aruco"),
        ({"kind": "line", "points_px": ((1, 2),)}, "line"),
        ({"kind": "patch", "points_px": ((1, 2),)}, "1 patch"),
        ({"points_px": ((1, 2), (3, 4))}, "2 patches"),
    ],
)
def test_the_list_of_recordings_says_what_is_followed(options, text):
    assert markers_text(RecordingConfig(file="a", **options)) == text


def test_names_are_inert():
    hostile = '</text><script>alert(1)</script><image href="http://evil.example"/>'
    (dot, text) = ET.fromstring(f"<svg>{marked([(hostile, 1.0, 2.0)], 'seen')}</svg>")  # noqa: S314 - made here
    assert dot.tag == "circle"
    assert text.text == hostile
    assert not list(text)


def test_trails_enlarge_the_motion_about_the_first_position():
    points = re.search(r'points="([^"]+)"', trail([10.0, 10.5], [20.0, 19.0], 10.0))[1]
    assert points == "10.50,20.50 15.50,10.50"

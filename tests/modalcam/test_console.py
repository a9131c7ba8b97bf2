"""What a finished run says in the terminal, and its exit code."""

import io
import json
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from modalcam.common import ExitCode
from modalcam.console import finish, problems, tracked
from modalcam.pace import Pace, duration, rest_of_run_s

TRACKING = {"time_axis": {"source": "settings", "notes": []}, "decode": {}}


def recording(file, *, failure="", failed_modes=(), modes=(), fitting_rate=None):
    proposed = [[10.0, 20.4], [30.0, 40.0]] if failure else None
    problem = {"failure": failure, "proposed_px": proposed, "failed_modes": list(failed_modes)}
    found = {"modes": list(modes), "fitting_rate": fitting_rate, "tracking": TRACKING}
    return {"file": file} | problem | found


def write_summary(folder, *recordings):
    provenance = {"program": "1.0", "command_line": "modalcam run videos"}
    tree = provenance | {"recordings": recordings, "aliases": [], "not_done": [], "config": "", "beam": None}
    (folder / "summary.json").write_text(json.dumps(tree))


GOOD = recording("good.avi")
FAILED = recording("bad.avi", failure="bad.avi: no marker was found")
HINT = """
  points with texture that moves, for kind = "patch": points_px = [[10, 20], [30, 40]]
  set points or a line by clicks: `modalcam studio FOLDER`, or `modalcam pick FILE`"""
NO_TARGET = recording("two.avi", failed_modes=[{"target": True, "reason": "the mode has no free decay"}])
WRONG_END = "Shape disagrees with theory (MAC 0.34); with the clamp at the other end 0.99."
REVERSED = recording("end.avi", modes=[{"mode": 4, "notes": ["Another note.", WRONG_END, "A third."]}])
RATE = {"recorded_hz": 30.0, "limits_hz": [500.0, 500.0], "ratio": 50 / 3, "line_hz": 3.192, "number": 4}
FITS = "at a sampling rate of 500 Hz (recorded: 30 Hz), a ratio of 16.7, the strongest line, 3.192 Hz, would be mode 4"
OTHER_RATE = recording("slow.avi", modes=REVERSED["modes"], fitting_rate=RATE)
NO_TARGET_AT_RATE = NO_TARGET | {"fitting_rate": RATE}
NO_OTHER_MODE = recording("one.avi", failed_modes=[{"target": False, "reason": "too weak"}])


@pytest.mark.parametrize(
    ("recordings", "internal_errors", "code", "text"),
    [
        ([GOOD, NO_OTHER_MODE], 0, ExitCode.OK, ""),
        ([GOOD, FAILED], 0, ExitCode.PARTIAL, "FAILED bad.avi: no marker was found" + HINT),
        ([GOOD, NO_TARGET], 0, ExitCode.PARTIAL, "NOT IDENTIFIED two.avi: the mode has no free decay"),
        ([GOOD, REVERSED], 0, ExitCode.PARTIAL, f"end.avi: mode 4: {WRONG_END}"),
        ([GOOD, OTHER_RATE], 0, ExitCode.PARTIAL, f"slow.avi: {FITS} of the beam"),
        ([NO_TARGET_AT_RATE], 0, ExitCode.PARTIAL, "NOT IDENTIFIED two.avi: the mode has no free decay"),
        ([FAILED], 0, ExitCode.NO_INPUT, "FAILED bad.avi: no marker was found" + HINT),
        ([GOOD], 1, ExitCode.INTERNAL, ""),
    ],
)
def test_problems_are_printed_and_decide_the_exit_code(recordings, internal_errors, code, text):
    summary = {"recordings": recordings, "not_done": []}
    printed = io.StringIO()
    assert problems(Console(file=printed, width=200), summary, internal_errors) == code
    assert printed.getvalue().strip() == text


def test_skipped_steps_and_a_playback_rate_are_named():
    axis = {"source": "container", "notes": ["30 fps is a playback rate"]}
    summary = {
        "recordings": [GOOD | {"tracking": {"time_axis": axis, "decode": {}}}],
        "not_done": ["There is no [beam]."],
    }
    printed = io.StringIO()
    assert problems(Console(file=printed, width=200), summary) == ExitCode.PARTIAL
    lines = printed.getvalue().splitlines()
    assert lines == ["WARNING good.avi: 30 fps is a playback rate", "note: There is no [beam]."]


@pytest.mark.parametrize(
    ("kind", "found"), [("line", "123 stations in 5 frames"), ("blob", "123 markers in 5 frames")]
)
def test_stations_of_a_line_are_not_called_markers(tmp_path, kind, found):
    axis = SimpleNamespace(source="settings", notes=(), is_playback_guess=False)
    tracks = SimpleNamespace(x_px=np.zeros((5, 123)), kind=kind, time_axis=axis, notes=())
    take = SimpleNamespace(name="take", file="take.avi", tracks=tracks, failure="")
    printed = io.StringIO()
    tracked(Console(file=printed, width=200), [take], tmp_path, 0)
    assert printed.getvalue().strip() == f"take: {found}"


def mode_of_summary(number, flags, severities=()):
    mode = {"target": True, "mode": number, "flags": flags, "severities": list(severities)}
    mode |= {"frequency_hz": 1031.9837, "frequency_sd_hz": 0.0002, "damping_ratio": 0.123456}
    mode |= {"damping_ratio_sd": 1e-5, "damping_ratio_interval_90": [0.12344, 0.12347]}
    small = ("frequency_small_amplitude_hz", "frequency_small_amplitude_sd_hz")
    small += ("damping_ratio_small_amplitude", "damping_ratio_small_amplitude_sd")
    return mode | dict.fromkeys(small, 1.0) | {"decays": [], "notes": []}


@pytest.mark.parametrize(
    ("severity", "strict", "code"),
    [("WRONG", True, ExitCode.PARTIAL), ("WRONG", False, ExitCode.OK), ("INTERVAL", True, ExitCode.OK)],
)
def test_strict_fails_where_a_value_may_be_wrong_and_quiet_prints_no_table(tmp_path, severity, strict, code):
    mode = mode_of_summary(1, ["NOT_CONFIRMED"], [["NOT_CONFIRMED", severity]])
    one = GOOD | {"recording": "good", "modes": [mode], "driven": [], "segments": []}
    write_summary(tmp_path, one)
    printed = io.StringIO()
    assert finish(Console(file=printed), tmp_path, as_json=False, quiet=True, strict=strict) == code
    assert printed.getvalue().startswith("--strict: ") == (code != ExitCode.OK)
    assert "1031" not in printed.getvalue()
    log = (tmp_path / "run.log").read_text()
    assert log.startswith("modalcam 1.0: modalcam run videos\n")
    assert "1031.98370 ± 0.00020" in log, "the log is never quiet"


@pytest.mark.parametrize("width", [40, 80, 160])
def test_neither_names_nor_numbers_nor_flags_are_cut(tmp_path, width):
    name, flags = "2024-05-12_beam_mode_3_take_07", ["AMPLITUDE_DEPENDENT", "DAMPING_TOUCHES_ZERO"]
    mode = mode_of_summary(3, flags)
    one = GOOD | {"recording": name, "modes": [mode], "driven": [], "segments": []}
    write_summary(tmp_path, one)
    printed = io.StringIO()
    finish(Console(file=printed, width=width), tmp_path, as_json=False)
    text = printed.getvalue()
    assert "1031.98370 ± 0.00020" in text
    assert "12.3456 ± 0.0010" in text
    assert "12.3440 … 12.3470" in text
    for word in (name, *flags):
        assert word in "".join(text.split()), f"{word} is cut in a terminal of {width} columns:\n{text}"


def test_frames_have_a_rate_and_a_time_left():
    """From the first frames on: 8 at 20 s; 300 at 22.92 s, of which 100 in a recording that ended."""
    pace = Pace(10.0, 3)
    pace.take("a", 0, 0)
    assert pace.frames(10.0) == "", "markers are being learned"
    assert pace.left_s(10.0) is None
    pace.take("a", 8, 100)
    assert pace.frames(20.0) == "8 of 100 frames"
    pace.take("a", 96, 100)
    pace.end("a", reused=False)
    pace.take("b", 50, 400)
    pace.take("c", 150, 400)
    assert pace.frames(22.92) == "200 of 800 frames, 100 a second"
    # one of three, an eighth and three eighths of the others, half of the stage in all, took 12.92 s
    assert pace.left_s(22.92) == pytest.approx(12.92)
    pace.take("c", 500, 400)
    pace.take("b", 400, 400)
    assert pace.frames(29.92) == "900 frames, 100 a second", "a file with more frames than it declares"


def test_results_that_are_used_again_give_no_pace():
    pace = Pace(0.0, 5)
    pace.end("a", reused=True)
    assert pace.left_s(1.0) is None
    pace.end("b", reused=False)
    assert pace.left_s(2.0) == pytest.approx(6.0), "one of the four others in 2 s"


def test_the_rest_of_a_run_is_in_proportion_to_its_stage():
    """Tracking that takes 17 s of a run in which it takes 17 %; without a beam 41 % of it, and at its end nothing."""
    assert rest_of_run_s(["reading", "tracking"], 17.0) == pytest.approx(79.0)
    before = ["reading", "tracking", "theory of the beam"]
    assert rest_of_run_s([*before, "identifying"], 18.0) == pytest.approx(61.0)
    assert rest_of_run_s(["tracking", "identifying"], 18.0) == pytest.approx(20.0)
    assert rest_of_run_s([*before, "identifying", "drawing", "writing"], 3.0) == 0.0
    assert rest_of_run_s(["running trials"], 5.0) is None
    assert [duration(s) for s in (0.3, 52.0, 240.0, 7200.0)] == ["5 s", "50 s", "4 min", "2.0 h"]


def test_without_a_recorded_rate_no_frequency_is_printed(tmp_path):
    axis = {"source": "container", "notes": ["30 fps is a playback rate"]}
    mode = mode_of_summary(1, ["FEW_CYCLES_LOST"])
    one = GOOD | {"recording": "good", "modes": [mode], "driven": [], "segments": []}
    printed = {}
    for name, tracking in (("known", TRACKING), ("unknown", {"time_axis": axis, "decode": {}})):
        write_summary(tmp_path, one | {"tracking": tracking})
        output = io.StringIO()
        finish(Console(file=output, width=120), tmp_path, as_json=False)
        printed[name] = output.getvalue()
    assert "1031.98" in printed["known"]
    assert "1031.98" not in printed["unknown"]
    assert "unknown" in printed["unknown"]
    assert "at small amplitude damping ratio" in printed["unknown"]

"""The command line: usage, errors, exit codes and short commands."""

import io
import json
import os
import re
import shutil
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from kit import films
from kit.series import ruler_with_click, several_plucks, steady_drive
from rich.console import Console
from support.command import invoked
from support.paths import APPS, COMMANDS_OF_APPS
from typer.testing import CliRunner

from modalcam import cli
from modalcam.cli import results_folder
from modalcam.commands import Options, track
from modalcam.common import ExitCode
from modalcam.config import load_config
from modalcam.console import exit_code, listener
from modalcam.pipeline import Limits


@pytest.fixture
def modalcam(modalcam, in_process, no_figures):
    """Commands whose tasks run in this process, without figures; test_commands.py has worker processes and figures."""
    return modalcam


def write_clip(path, frames=12):
    films.write(path, films.images(frames, 64, 48), codec="ffv1", rate=30)


@pytest.fixture
def videos(tmp_path):
    folder = tmp_path / "videos"
    folder.mkdir()
    write_clip(folder / "take.mkv")
    return folder


COMMANDS = "run track identify simulate report verify init probe check-config info figures".split()  # noqa: SIM905
COMMANDS += COMMANDS_OF_APPS if APPS else []


def test_help_and_version(modalcam):
    code, out, _ = modalcam("-h")
    assert code == 0
    assert all(command in out for command in COMMANDS)
    headings = [line.split(maxsplit=1)[1].rstrip("─╮ ") for line in out.splitlines() if line[:1] == "╭"]
    assert headings == ["Options", "Commands", "Before a run", "Results of a run", "Without recordings"]
    assert len(out.splitlines()) <= 48
    assert modalcam("--version")[1].startswith("modalcam ")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_help_fits_a_screen(command):
    shown = CliRunner().invoke(cli.app, [command, "--help"], env={"COLUMNS": "100", "TERMINAL_WIDTH": "100"})
    assert shown.exit_code == 0, shown.output
    assert len(shown.output.splitlines()) <= 44, shown.output
    assert "config:" not in shown.output


def test_help_of_configuration_options_is_their_description():
    shown = CliRunner().invoke(cli.app, ["identify", "--help"], env={"TERMINAL_WIDTH": "100"})
    assert "Number of the mode that was excited, from 1." in " ".join(shown.output.replace("│", " ").split())


def test_a_file_that_is_not_a_video_fails_with_a_message(modalcam, tmp_path):
    folder = tmp_path / "videos"
    folder.mkdir()
    (folder / "empty.mp4").write_bytes(b"")
    (folder / "text.avi").write_text("not a video at all\n" * 50)
    code, _, err = modalcam("run", folder, "-o", tmp_path / "out", "--jobs", 1)
    assert code == 3
    assert err.count("not a video") == 2
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [bool(r["failure"]) for r in summary["recordings"]] == [True, True]
    assert "not a video" in (tmp_path / "out" / "report.html").read_text()


def test_probe_reports_rates_and_sizes(modalcam, videos):
    code, out, _ = modalcam("probe", videos, "--json")
    (found,) = json.loads(out)
    assert code == 0
    assert (found["size_px"], found["packets"], found["bit_depth"]) == ("64 x 48", 12, 8)
    assert found["fps_container"] == 30.0
    assert found["fps_recorded"] is None
    assert any("recorded rate is unknown" in note for note in found["notes"])


def test_init_writes_every_option_and_reads_back(modalcam, videos, tmp_path):
    path = tmp_path / "experiment.toml"
    assert modalcam("init", videos, "-o", path)[0] == 0
    assert [r.file for r in load_config(path).recordings] == ["take.mkv"]
    code, _, err = modalcam("init", videos, "-o", path)
    assert code == 2
    assert "exists already" in err
    # commented options are valid when enabled, except two that need other options
    lines = path.read_text().splitlines()
    path.write_text(
        "\n".join(
            line.removeprefix("#") if line.startswith("#") and not line.startswith("# ") else line
            for line in lines
            if not line.startswith(("#lens", "#angle_deg"))
        )
    )
    config = load_config(path)
    assert config.camera.fps == Fraction(1000)
    assert config.beam.point_masses[0].mass_g == 0.4
    assert config.recordings[0].mode == 1


def test_check_config_prints_the_resolved_configuration(modalcam, tmp_path):
    path = tmp_path / "experiment.toml"
    path.write_text("[camera]\nfps = 500\n")
    code, out, _ = modalcam("check-config", path)
    assert code == 0
    assert "fps = 500.0" in out
    assert modalcam("check-config", tmp_path)[:2] == (0, out), "of a folder, its experiment.toml"
    path.write_text("[camera]\nfpss = 500\n")
    code, _, err = modalcam("check-config", path)
    assert code == 2
    assert "did you mean 'fps'" in err
    # what a run would refuse, for each recording
    path.write_text('[markers]\nkind = "patch"\n[[recordings]]\nfile = "a.avi"\npoints_px = [[9.0, 9.0]]\n')
    assert modalcam("check-config", path)[0] == 0
    path.write_text(path.read_text() + '[[recordings]]\nfile = "b.avi"\n')
    code, _, err = modalcam("check-config", path)
    assert code == 2
    assert "b.avi: kind 'patch' tracks points that you give" in err


def test_info_names_versions(modalcam):
    _, out, _ = modalcam("info")
    assert f"numpy {np.__version__}" in out


def test_track_one_file(modalcam, videos, tmp_path):
    asked = ("track", videos / "take.mkv", "-o", tmp_path / "out", "--fps", 120, "--jobs", 1)
    code, _, err = modalcam(*asked)
    assert code == 0, err
    rows = (tmp_path / "out" / "tracks" / "take.csv").read_text().splitlines()
    assert len(rows) == 13
    last = dict(zip(rows[0].split(","), rows[-1].split(","), strict=True))
    assert float(last["time_s"]) == pytest.approx(11 / 120)
    assert float(last["x_px"]) == pytest.approx(32 + 5 * np.sin(5.5), abs=0.05)
    assert last["x_mm"] == "NaN"
    assert "take: 1 marker in 12 frames" in err
    code, out, err = modalcam(*asked, "-q")
    assert (code, out, err) == (0, f"{tmp_path / 'out' / 'tracks'}\n", ""), "neither failure nor warning"


def test_a_recording_that_takes_too_long_fails_with_the_reason(videos, tmp_path):
    # No file can be hashed, decoded and tracked in a millisecond.
    options = Options(tmp_path / "out", limits=Limits(seconds=1e-3))
    with listener(Console(file=io.StringIO()), 0) as progress:
        recordings, internal_errors = track(videos, options, progress)
    assert "did not finish within 0.001 s" in recordings[0].failure
    assert internal_errors == 0
    assert exit_code([r.failure for r in recordings], internal_errors) == ExitCode.NO_INPUT


def test_a_listed_but_missing_file_fails_and_a_name_that_is_not_utf8_does_not(modalcam, tmp_path):
    folder = tmp_path / "videos"
    folder.mkdir()
    write_clip(folder / "take.mkv")
    (folder / "take.mkv").rename(folder / os.fsdecode(b"b\xff.mkv"))
    (folder / "experiment.toml").write_text('[camera]\nfps = 120\n[[recordings]]\nfile = "gone.avi"\n')
    code, _, err = modalcam("run", folder, "-o", tmp_path / "out", "--jobs", 1)
    assert code in (3, 4), err
    assert "gone.avi: it is listed in the configuration but is not in the folder" in err
    assert len(list((tmp_path / "out" / "tracks").iterdir())) == 1


def test_a_wrong_configuration_is_not_an_internal_error(modalcam, videos, tmp_path):
    (videos / "experiment.toml").write_text(
        '[camera]\nfps = 120\n[markers]\nkind = "aruco"\ndictionary = "DICT_9X9_50"\n'
    )
    code, _, err = modalcam("run", videos, "-o", tmp_path / "out", "--jobs", 1)
    assert code == 2
    assert "markers.dictionary: expected an ArUco dictionary of OpenCV such as DICT_" in err
    (videos / "experiment.toml").write_text('[camera]\nfps = 120\n[markers]\nkind = "patch"\n')
    code, _, err = modalcam("run", videos, "-o", tmp_path / "out", "--jobs", 1)
    assert code == 3
    assert "kind 'patch' tracks points that you give" in err


def write_series(path, time_s, values):
    table = np.column_stack([time_s, values])
    header = ",".join(["time_s", *"abc"[: table.shape[1] - 1]])
    np.savetxt(path, table, delimiter=",", header=header, comments="")


@pytest.mark.parametrize(
    ("where", "target", "expected"),
    [
        ("", "videos", "videos-results"),
        ("", "videos/take.avi", "take-results"),
        ("", "videos/deeper", "deeper-results"),
        ("videos", ".", "../videos-results"),
        ("videos", "take.avi", "../take-results"),
        ("videos/deeper", "..", "../../videos-results"),
        ("other", "../videos", "videos-results"),
    ],
)
def test_without_a_folder_for_the_results_it_is_named_after_the_input_and_never_among_it(
    tmp_path, monkeypatch, where, target, expected
):
    for folder in ("videos/deeper", "other"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "videos" / "take.avi").touch()
    monkeypatch.chdir(tmp_path / where)
    found = results_folder(Path(target)).absolute().resolve()
    assert found == (tmp_path / where / expected).resolve()
    source = Path(target).resolve()
    folder = source.parent if source.is_file() else source
    assert not found.is_relative_to(folder), "a later run would read its own results as recordings"


@pytest.mark.usefixtures("in_process")
def test_identify_names_the_parts_of_a_record_and_values_at_small_amplitude(tmp_path, modalcam, monkeypatch):
    """A ruler: at rest, plucked at 0.55 s, zeta falls to 0.8 % with the amplitude, a click at 2 s."""
    for name in ("tables", "work"):
        (tmp_path / name).mkdir()
    write_series(tmp_path / "tables" / "ruler.csv", *ruler_with_click())
    monkeypatch.chdir(tmp_path / "work")
    code, _, said = modalcam("identify", tmp_path / "tables" / "ruler.csv")
    assert code == ExitCode.OK
    assert (tmp_path / "work" / "ruler-results" / "report.html").is_file()
    assert "ruler: at rest from 0 s to 0.5" in said
    assert "decay from 0.5" in said
    # a quarter of a cycle of 38.4 Hz is left out on either side of a click
    begun = re.search(r"disturbed from (\S+) s to 2\.0", said)
    assert begun is not None, said
    assert abs(float(begun[1]) - 2.0) < 0.25 / 38.4 + 0.001
    assert "ruler: at small amplitude 38." in said
    assert "damping ratio 0.8" in said
    assert "AMPLITUDE_DEPENDENT" in said


@pytest.mark.usefixtures("in_process")
def test_identify_says_of_decays_what_each_gives_and_of_driving_that_nothing_decays(tmp_path, modalcam):
    for name, record in (("plucks", several_plucks()), ("drive", steady_drive())):
        write_series(tmp_path / f"{name}.csv", *record)
    code, _, said = modalcam("identify", tmp_path / "plucks.csv", "-o", tmp_path / "plucks")
    assert code == ExitCode.OK
    assert "plucks: 4 decays, with damping ratios of 0.8" in said
    assert said.count("decay from") == 4
    code, _, said = modalcam("identify", tmp_path / "drive.csv", "-o", tmp_path / "drive")
    assert code == ExitCode.PARTIAL
    assert "DRIVEN" in said
    assert "does not decay: it is driven" in said


def test_run_of_one_file_leaves_the_others_of_its_folder_alone(modalcam, tmp_path):
    for name in ("a.avi", "b.avi"):
        (tmp_path / name).write_text("no video")
    code, _, err = modalcam("run", tmp_path / "b.avi", "-o", tmp_path / "out")
    assert code == ExitCode.NO_INPUT
    assert "FAILED b.avi" in err
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [recording["file"] for recording in summary["recordings"]] == ["b.avi"]
    # the same folder of results is not that of the whole folder
    code, _, err = modalcam("run", tmp_path, "-o", tmp_path / "out")
    assert code == ExitCode.USAGE
    assert "b.avi" in err


def test_several_recordings_of_a_folder_are_run_together(modalcam, tmp_path):
    for name in ("a.avi", "b[1].avi", "c.avi", "elsewhere/d.avi"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("no video")
    two = [tmp_path / name for name in ("a.avi", "b[1].avi")]
    assert modalcam("run", *two, "-o", tmp_path / "out")[0] == ExitCode.NO_INPUT
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [recording["file"] for recording in summary["recordings"]] == ["a.avi", "b[1].avi"]
    code, _, err = modalcam("run", two[0], tmp_path / "elsewhere" / "d.avi")
    assert code == ExitCode.USAGE
    assert "d.avi: not a recording of the folder" in err


def test_verify_names_what_has_changed_since_the_run(modalcam, decay_run, tmp_path):
    out, videos = tmp_path / "out", tmp_path / "videos"
    shutil.copytree(decay_run / "out", out)
    shutil.copytree(decay_run / "videos", videos)
    code, printed, _ = modalcam("verify", out, videos)
    assert code == ExitCode.OK
    total = int(printed.split()[0])
    assert printed.strip() == f"{total} of {total} files are those of the run"
    (out / "modes.csv").write_text("mode")
    (out / "report.html").unlink()
    (recording,) = videos.glob("*.mkv")
    with recording.open("ab") as file:
        file.write(b"0")
    code, printed, _ = modalcam("verify", out, videos)
    assert code == ExitCode.PARTIAL
    assert "modes.csv: changed since the run" in printed
    assert "report.html: missing" in printed
    assert f"{recording.name}: changed since the run" in printed
    assert f"{total - 3} of {total} files" in printed
    assert modalcam("verify", tmp_path)[0] == ExitCode.USAGE


def test_shells_complete_commands():
    asked = {"_MODALCAM_COMPLETE": "complete_bash", "COMP_WORDS": "modalcam re", "COMP_CWORD": "1"}
    shown = CliRunner().invoke(cli.app, [], env=asked, prog_name="modalcam")
    assert shown.output.split() == (["report", "render"] if APPS else ["report"])


def test_identify_says_what_it_took_for_what(tmp_path, modalcam):
    time_s = np.arange(1500) / 500.0
    motion = np.exp(-0.4 * time_s) * np.cos(77.0 * time_s) + 1e-3 * np.sin(1e3 * time_s**2)
    rows = "\n".join(f"{t:.4f};{x:.6f}".replace(".", ",") for t, x in zip(time_s, motion, strict=True))
    (tmp_path / "a.csv").write_text(f"Zeit;Sensor\n{rows}\n")
    code, _, said = modalcam("identify", tmp_path / "a.csv", "-o", tmp_path / "out")
    assert code == ExitCode.OK
    assert "columns between semicolons and decimal commas" in said
    assert "column Zeit holds the times in s; channels are Sensor." in said
    # Noise of a sweep through all frequencies is no reason to doubt the values, so that the strict command succeeds.
    code, _, said = modalcam("identify", tmp_path / "a.csv", "-o", tmp_path / "out", "-q", "--strict")
    assert code == ExitCode.OK
    assert "Zeit" not in said
    assert "frequency / Hz" not in said


def test_progress_for_a_program_is_one_object_a_line(videos, tmp_path, in_process, no_figures):
    """Stages with their tasks, failures without a line break, and at last the exit code; the report's path as ever."""
    given = ("run", videos, "-o", tmp_path / "out", "--jobs", 1, "--progress", "json")
    done = invoked(*given)
    events = list(map(json.loads, done.stderr.splitlines()))
    assert events[-1] == {"event": "end", "exit_code": done.exit_code}
    assert done.stdout == f"{tmp_path / 'out' / 'report.html'}\n"
    assert events[0] == {"event": "begin", "stage": "reading", "total": 1}
    assert {"event": "advance", "name": "take", "reused": False} in events
    assert any(event.get("text", "").startswith("NOT IDENTIFIED take.mkv: ") for event in events)
    (videos / "take.mkv").unlink()
    done = invoked(*given)
    said, end = map(json.loads, done.stderr.splitlines())
    assert (done.exit_code, done.stdout, end["exit_code"]) == (ExitCode.NO_INPUT, "", ExitCode.NO_INPUT)
    assert "no recording" in said["text"]

"""`modalcam run` as a separate process: reuse, plugins, interrupts, same bytes for any number of processes."""

import csv
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time

import pytest
from kit.films import EXPERIMENT, write_decay
from support.paths import APPS, ROOT

from modalcam import plugins
from modalcam.commands import Options, _find, _inputs_key, report
from modalcam.common import InputError, ModalcamError
from modalcam.inputs import Selection
from modalcam.pipeline import Progress, RememberedHashes, Workspace, digest, file_sha256, load, load_run
from sim.damping import registry

pytestmark = pytest.mark.timeout(600)

PLUGIN = """
from sim.damping import DampingModelEntry, GenericDamping, register_damping_model

def build(measured, omega_rad_s):
    return GenericDamping((sum(measured.damping_ratio) / len(measured.damping_ratio),) * len(omega_rad_s))

register_damping_model(DampingModelEntry(
    key="toy_mean", name="toy mean damping", description="One ratio for every mode.",
    colour="#123456", dark_colour="#abcdef", build=build, draw_stride=8))
"""
# A suite started in the background ignores the signal of Ctrl-C, and its processes inherit that.
FOREGROUND = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)
os.execv(sys.argv[1], sys.argv[1:])
"""
# Tracking and identification of each recording wait until a file allows them to go on.
PAUSES = """
import os
import pathlib
import sys
import time

import modal_id.identify
import tracker.track

def paused(module, name):
    function, folder = getattr(module, name), pathlib.Path(os.environ["PAUSES"])
    def wait(*args, **kwargs):
        (folder / f"{name}.{os.getpid()}").touch()
        while not (folder / f"{name}.go").exists():
            time.sleep(0.02)
        return function(*args, **kwargs)
    setattr(module, name, wait)

paused(sys.modules["tracker.track"], "track_source")
paused(sys.modules["modal_id.identify"], "identify")
"""


def command(folder, out, *args):
    base = [sys.executable, "-m", "modalcam", "run", folder / "videos", "-o", out, "--plugin", "toy_damping"]
    return [str(part) for part in (*base, *args)]


def environment(folder):
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(folder)])}


def ended(words, folder, seconds):
    given = {"env": environment(folder), "capture_output": True, "text": True, "timeout": seconds}
    return subprocess.run(words, **given, check=False)


def run(folder, out, *args):
    done = ended(command(folder, out, *args), folder, 500)
    return done, " ".join(done.stderr.split())


@pytest.fixture(scope="module")
def folder(tmp_path_factory, decay_run):
    """That of the shared run and one with damaged frames, and a plugin whose damping model is selected."""
    folder = tmp_path_factory.mktemp("commands")
    write_decay(folder / "videos", name="b", seed=2)
    shutil.copy(decay_run / "videos" / "take.mkv", folder / "videos")
    damaged = bytearray((folder / "videos" / "b.mkv").read_bytes())
    middle = len(damaged) // 2
    damaged[middle : middle + 8] = bytes(255 - value for value in damaged[middle : middle + 8])
    (folder / "videos" / "b.mkv").write_bytes(damaged)
    models = '[damping]\nmodels = ["generic", "toy_mean"]\n'
    (folder / "videos" / "experiment.toml").write_text(EXPERIMENT.lstrip() + models)
    (folder / "toy_damping.py").write_text(PLUGIN)
    (folder / "pauses.py").write_text(PAUSES)
    # the next run would read a recording again that changed within the last two seconds
    time.sleep(2.1)
    return folder


@pytest.fixture(scope="module")
def out(folder):
    """Results of a run with two processes."""
    out = folder / "out"
    done, err = run(folder, out, "--jobs", 2)
    assert done.returncode == 0, err
    assert done.stdout.strip() == str(out / "report.html")
    for line in (
        "tracking: computed",
        "identifying: computed",
        "updating the beam: computed bayesian, evidence, paper, uniform",
    ):
        assert line in err
    return out


@pytest.fixture
def toy_damping(folder, monkeypatch):
    """The plugin, loaded in this process during a test."""
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setattr(plugins, "_LOADED", {})
    monkeypatch.delitem(sys.modules, "toy_damping", raising=False)
    yield "toy_damping"
    registry.DAMPING_MODELS.pop("toy_mean", None)


def contents(out):
    return {
        path.relative_to(out).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name != "lock"
    }


def test_a_damping_model_of_a_plugin_is_in_tables_and_report(out):
    with (out / "comparison.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {(row["recording"], row["model"]) for row in rows} == {
        (name, model) for name in ("b", "take") for model in ("generic", "toy_mean")
    }
    assert "Toy mean damping" in (out / "report.html").read_text("utf-8")


def test_a_run_without_changes_imports_nothing_heavy_and_writes_nothing(folder, out):
    before = contents(out)
    stamps = {path: path.stat().st_mtime_ns for path in out.rglob("*.*")}
    script = (
        "import sys; from modalcam import cli\n"
        "try: cli.main()\n"
        "except SystemExit as end: assert not end.code, end.code\n"
        "heavy = {'numba', 'cv2', 'matplotlib', 'scipy', 'pandas', 'xarray'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    args = [sys.executable, "-c", script, *command(folder, out)[3:]]
    done = ended(args, folder, 60)
    assert done.returncode == 0, done.stderr
    assert "up to date" in done.stderr
    assert "generic" not in done.stderr
    assert done.stdout.strip() == str(out / "report.html")
    assert contents(out) == before
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*.*")} == stamps


def test_a_configuration_edited_during_a_run_does_not_count_as_run(tmp_path):
    (tmp_path / "a.avi").touch()
    config = tmp_path / "experiment.toml"
    config.write_text("[camera]\nfps = 1000.0\n")
    key = _inputs_key(tmp_path, Options(tmp_path / "out"), None)
    before = key(lambda _: "00")
    config.write_text("[camera]\nfps = 2000.0\n")
    assert key(lambda _: "00") == before
    assert _inputs_key(tmp_path, Options(tmp_path / "out"), None)(lambda _: "00") != before


def test_only_missing_or_edited_files_are_written_again(folder, out):
    before = contents(out)
    (out / "modes.csv").write_text("edited")
    (out / "report.html").unlink()
    unchanged = (out / "comparison.csv").stat().st_mtime_ns
    done, err = run(folder, out)
    assert done.returncode == 0, err
    assert "identifying: reused b, take" in err
    assert ("filming the simulation: reused b, take" in err) == APPS
    assert "writing: reused" in err
    assert contents(out) == before
    assert (out / "comparison.csv").stat().st_mtime_ns == unchanged


@pytest.mark.slow
def test_the_bytes_are_the_same_for_another_number_of_processes(folder, out, tmp_path):
    done, err = run(folder, tmp_path / "out", "--jobs", 1)
    assert done.returncode == 0, err
    assert contents(tmp_path / "out") == contents(out)


@pytest.mark.parametrize("stage", ["tracks", "modes", "frames"])
def test_two_processes_compute_what_one_does(out, decay_run, stage):
    """The recording that both runs have; the test above compares every byte, and test_dask those of all stages."""
    found, alone = (digest(load(run / "state" / f"take.{stage}.npz")) for run in (out, decay_run / "out"))
    assert found == alone
    corrupt = [(out / "tracks" / f"{name}.csv").read_text().count("DECODE_CORRUPT") for name in ("take", "b")]
    assert corrupt[0] == 0 < corrupt[1], "one of the recordings is damaged"


def test_a_finished_run_is_loaded_and_reported_without_computing(out, monkeypatch, toy_damping):
    with pytest.raises(ModalcamError, match="expected a damping model"):
        _ = load_run(out).recordings
    monkeypatch.setattr("modalcam.commands.worker_pool", None)
    before = contents(out)
    reported = report(Options(out, plugins=(toy_damping,)), Progress())
    assert contents(out) == before
    result = load_run(out, plugins=(toy_damping,))
    assert reported.resolved_config == result.resolved_config
    assert result.command_line == "modalcam run videos --seed 0 --plugin toy_damping"
    with (out / "modes.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    table = result.to_dataframe()
    assert list(table.columns) == list(rows[0])
    assert [f"{value!r}" for value in table["frequency_hz"]] == [row["frequency_hz"] for row in rows]
    assert [recording.name for recording in result.recordings] == ["b", "take"]
    assert all(("simulated" in r.added) == APPS for r in result.recordings)
    assert all(r.tracks and r.comparison and all(r.added.values()) for r in result.recordings)
    assert result.beam.updated is not None


def test_a_run_with_a_missing_result_fails_with_advice(out, toy_damping):
    path = Workspace(out).state("take", "modes")
    path.rename(path.with_suffix(".away"))
    try:
        result = load_run(out, (toy_damping,))
        words = r"take\.modes\.npz: expected the result .* run the same command again"
        with pytest.raises(InputError, match=words):
            _ = result.recordings
    finally:
        path.with_suffix(".away").rename(path)
    with pytest.raises(InputError, match="holds no results"):
        load_run(out / "state")


def test_a_changed_recording_of_equal_size_and_time_is_detected(tmp_path):
    clip = tmp_path / "a.avi"
    clip.write_bytes(b"before")
    os.utime(clip, (1e9, 1e9))
    time.sleep(2.1)
    hashes = RememberedHashes(tmp_path / "inputs.json")
    stamp = hashes.stamp(clip)
    hashes.store({clip: stamp}, {clip: file_sha256(clip)})
    again = RememberedHashes(tmp_path / "inputs.json")
    assert again.get(clip) == file_sha256(clip)
    clip.write_bytes(b"after.")
    os.utime(clip, (1e9, 1e9))
    assert again.get(clip) is None
    # It has just changed: the time resolution of a file system may hide another change.
    assert again.stamp(clip) is None
    assert RememberedHashes(tmp_path / "absent.json").get(clip) is None


class Started:
    """A run in a separate process that pauses in each stage; its standard error is read continuously."""

    def __init__(self, folder, out, pauses, jobs):
        self.pauses = pauses
        pauses.mkdir()
        words = command(folder, out, "--plugin", "pauses", "--jobs", jobs, "-v")
        streams = {"stderr": subprocess.PIPE, "stdout": subprocess.DEVNULL, "text": True}
        given = {"env": environment(folder) | {"PAUSES": str(pauses)}, "start_new_session": True}
        self.process = subprocess.Popen([sys.executable, "-c", FOREGROUND, *words], **streams, **given)
        self.lines = []
        self.new_line = threading.Condition()
        self.reader = threading.Thread(target=self.read, daemon=True)
        self.reader.start()

    def read(self):
        for line in self.process.stderr:
            with self.new_line:
                self.lines.append(line.strip())
                self.new_line.notify_all()

    def wait_for(self, start):
        """Wait for a line with this start."""
        with self.new_line:
            found = self.new_line.wait_for(lambda: any(x.startswith(start) for x in self.lines), 300)
        assert found, self.lines

    def wait_for_pauses(self, function, count):
        """Wait until this number of processes pause in the function."""
        while len(list(self.pauses.glob(f"{function}.*"))) < count:
            assert self.process.poll() is None, self.lines
            time.sleep(0.02)

    def ends(self):
        """Wait for the end and for all output; return the exit code."""
        code = self.process.wait(300)
        self.reader.join(60)
        self.process.stderr.close()
        return code

    def output(self):
        """All lines, joined."""
        return " ".join(self.lines)

    def interrupt(self):
        """Send the signal of Ctrl-C to every process of the group."""
        os.killpg(self.process.pid, signal.SIGINT)


def test_an_interrupt_finishes_and_saves_the_running_tasks(folder, tmp_path):
    out = tmp_path / "out"
    started = Started(folder, out, tmp_path / "first", jobs=2)
    started.wait_for_pauses("track_source", 2)
    started.interrupt()
    # Answered while both recordings are being tracked: they cannot end before the file exists.
    started.wait_for("finishing 2 recordings; press again to stop now")
    (started.pauses / "track_source.go").touch()
    assert started.ends() == 130
    assert "run the same command again" in started.output()
    assert {path.name for path in (out / "state").glob("*.tracks.npz")} == {"b.tracks.npz", "take.tracks.npz"}
    assert not list(out.glob("*.html"))

    again = Started(folder, out, tmp_path / "second", jobs=1)
    again.wait_for("b: reused")
    again.wait_for_pauses("identify", 1)
    again.interrupt()
    again.wait_for("finishing 1 recording")
    again.interrupt()
    # Ends although the identification would wait for ever.
    assert again.ends() == 130
    assert not list((out / "state").glob("*.modes.npz"))
    assert group_ended(again.process.pid, 60), "a process of the run is left"


def group_ended(group, seconds):
    """Whether all processes of the group end in time; helper processes of Python end after their parent."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


def test_recordings_are_left_out_by_the_configuration(tmp_path):
    folder, options = tmp_path / "videos", Options(out=tmp_path / "out")
    for name in ("a", "b"):
        write_decay(folder, name=name)
    left_out = '[[recordings]]\nfile = "{}.mkv"\nleave_out = true\n'
    (folder / "experiment.toml").write_text(left_out.format("b"))
    _, recordings, notes = _find(folder, options, None)
    assert [one.file for one in recordings] == ["a.mkv"]
    assert "Left out by the configuration: b.mkv." in notes
    _, (alone,), _ = _find(folder, options, "b.mkv")
    assert alone.file == "b.mkv", "a recording that is named is wanted"
    (folder / "experiment.toml").write_text(left_out.format("a") + left_out.format("b"))
    with pytest.raises(InputError, match="leaves out every recording"):
        _find(folder, options, None)


def test_recordings_are_selected_by_patterns(tmp_path):
    """Also one that only the configuration names: it is not missing where it is not wanted."""
    folder = tmp_path / "videos"
    (folder / "day2").mkdir(parents=True)
    for name in ("a1", "a2", "b1", "day2/a1"):
        (folder / f"{name}.mkv").touch()
    (folder / "experiment.toml").write_text('[[recordings]]\nfile = "c.mkv"\n')

    def selected(*include, exclude=()):
        options = Options(tmp_path / "out", selection=Selection(include, exclude))
        _, recordings, notes = _find(folder, options, None)
        return [one.file for one in recordings], notes

    assert selected("a*.mkv", "b1.mkv") == (["a1.mkv", "a2.mkv", "b1.mkv", "day2/a1.mkv"], ())
    files, notes = selected("a*.mkv", exclude=("day2/*", "a2.*"))
    assert files == ["a1.mkv"]
    assert notes == ("Left out by --include and --exclude: a2.mkv, b1.mkv, day2/a1.mkv.",)
    assert selected("b*")[0] == ["b1.mkv"]
    assert selected(exclude=("a*",))[0] == ["b1.mkv", "c.mkv"], "c.mkv is wanted and missing"
    words = r"leave out every recording of the folder: a1.mkv, a2.mkv, b1.mkv, day2"
    with pytest.raises(InputError, match=words):
        selected("x*")

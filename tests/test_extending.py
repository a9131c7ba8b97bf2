"""The examples of docs/extending.md: all plugins in one run on a short clip, a command, an option."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest
from kit.films import EXPERIMENT, FPS, FRAMES, HEIGHT, WIDTH, decay_px
from pydantic import ValidationError, create_model
from support.paths import ROOT

from modalcam import load_run
from modalcam.config import BeamConfig, ExperimentConfig, commented_toml, markdown

PLUGINS = ("squares", "mean_ratio", "npy_reader", "frequencies", "path_figure", "brightness")
SETTINGS = EXPERIMENT.replace('"blob"', '"square"') + '[damping]\nmodels = ["generic", "mean_ratio"]\n'


# Figures take most of the time of a report; the plugin loaded after this one adds the only one. Nor is there a process
# for each task, which would import for seconds.
QUICK = """
from support.worker_tasks import InThisProcess
from modalcam.pipeline import pool
from modalcam.report.figures import FIGURES

FIGURES.clear()
pool.LocalExecutor = InThisProcess
"""


def examples():
    """Python and template blocks by the file name in their first line."""
    text = (ROOT / "docs/extending.md").read_text(encoding="utf-8")
    blocks = re.findall(r"(?ms)^```\w+\n(?:# |{# )([\w./]+)(?: #})?\n(.*?)^```$", text)
    return dict(blocks)


@pytest.fixture
def plugins(tmp_path):
    """A folder with all examples as files, and with the entry point of the command as that of a distribution."""
    folder = tmp_path / "plugins"
    for name, text in examples().items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    (folder / "quick.py").write_text(QUICK, encoding="utf-8")
    distribution = folder / "longest-1.0.dist-info"
    distribution.mkdir()
    (distribution / "METADATA").write_text("Metadata-Version: 2.1\nName: longest\nVersion: 1.0\n", "utf-8")
    (distribution / "entry_points.txt").write_text("[modalcam.commands]\nlongest = longest\n", "utf-8")
    return folder


def run(plugins, *arguments):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests"), str(plugins)])}
    command = [sys.executable, "-m", "modalcam", *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=840, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def write_clip(path):
    """A bright square that oscillates in mode 2 of a beam and comes to rest."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    images = []
    for swing in decay_px(np.arange(FRAMES) / FPS):
        edges = [np.clip(6.5 - np.abs(axis), 0.0, 1.0) for axis in (x - 32 - swing, y - 16)]
        image = 60.0 + 140.0 * edges[0] * edges[1] + rng.normal(0.0, 1.5, x.shape)
        images.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    np.save(path, np.array(images))


def test_every_example_is_covered():
    modules = {name.split("/")[0].removesuffix(".py") for name in examples()}
    assert modules == {*PLUGINS, "npz_series", "longest", "option", "threshold"}


@pytest.mark.timeout(900)
def test_all_plugins_reach_the_report(tmp_path, plugins):
    videos, out = tmp_path / "videos", tmp_path / "out"
    videos.mkdir()
    write_clip(videos / "take.npy")
    (videos / "experiment.toml").write_text(SETTINGS.lstrip(), encoding="utf-8")
    names = ("quick", *PLUGINS)
    run(plugins, "run", videos, "-o", out, "--jobs", "1", *(x for n in names for x in ("--plugin", n)))
    report = (out / "report.html").read_text(encoding="utf-8")
    # The reader by its codec, the kind by its marker's name, the damping law by its name and colour, the figure by its
    # title, the stage and the section by their sentence.
    expected = ("take.npy", "<dd>npy, ", "square1", "ean damping", "#2b6e4f", "Path of the first marker")
    for words in (*expected, "Mean grey level of the first frame: "):
        assert words in report, words
    grey = float(re.search(r"Mean grey level of the first frame: ([\d.]+)\.<", report)[1])
    first = np.load(videos / "take.npy", mmap_mode="r")[0]
    assert grey == pytest.approx(first.mean(), rel=5e-3), "printed with three digits"
    (frequency, *_) = (out / "frequencies.txt").read_text(encoding="utf-8").splitlines()
    assert float(frequency.removesuffix(" Hz")) == pytest.approx(10.2, abs=0.01)


def test_a_series_is_read_in_the_format_of_a_plugin(tmp_path, plugins):
    time_s = np.arange(600) / 300.0
    noise = np.random.default_rng(1).normal(0.0, 1e-3, time_s.size)
    decay = np.exp(-time_s) * np.cos(2 * np.pi * 10.2 * time_s)
    np.savez(tmp_path / "take.npz", time_s=time_s, displacement_mm=decay + noise)
    out = tmp_path / "out"
    options = ("--unit", "mm", "--plugin", "quick", "--plugin", "npz_series")
    run(plugins, "identify", tmp_path / "take.npz", "-o", out, *options)
    (mode,) = (load_run(out).recordings)[0].identification.modes
    assert mode.frequency_hz == pytest.approx(10.2, abs=0.01)
    assert "The series is read from a NumPy archive." in (out / "report.html").read_text(encoding="utf-8")


def test_a_command_of_a_plugin_reads_the_results(plugins, decay_run):
    assert run(plugins, "longest", decay_run / "out").strip() == "take.mkv"
    assert "longest " in run(plugins, "--help")


def test_an_option_is_documented_and_checked_by_its_field():
    made = {}
    exec(examples()["option.py"], made)  # noqa: S102 - our own document
    section = made["ClampWithGap"]
    beam = create_model("Beam", __base__=BeamConfig, clamp=(section | None, None))
    experiment = create_model("Experiment", __base__=ExperimentConfig, beam=(beam | None, None))
    assert "#gap_mm = 0.05" in commented_toml(experiment)
    assert "| `gap_mm` | number ≥ 0 | mm | `0.0` | Play between clamp and beam. |" in markdown(experiment)
    with pytest.raises(ValidationError, match="greater than or equal to 0"):
        section(gap_mm=-1.0)

"""The examples of CONTRIBUTING.md: four plugins in one run on a short clip, and an option."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest
from pydantic import ValidationError, create_model
from support.decay_clip import EXPERIMENT, FPS, FRAMES, HEIGHT, WIDTH, swing_px
from support.paths import ROOT

from modalcam.config import BeamConfig, ExperimentConfig, commented_toml, markdown

PLUGINS = ("squares", "mean_ratio", "npy_reader", "frequencies")
SETTINGS = EXPERIMENT.replace('"blob"', '"square"') + '[damping]\nmodels = ["generic", "mean_ratio"]\n'


def examples():
    """Python blocks by the file name in their first line."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n# (\w+)\.py\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)
    return dict(blocks)


def write_clip(path):
    """A bright square that oscillates in mode 2 of a beam and comes to rest."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    images = []
    for swing in swing_px(np.arange(FRAMES) / FPS):
        edges = [np.clip(6.5 - np.abs(axis), 0.0, 1.0) for axis in (x - 32 - swing, y - 16)]
        image = 60.0 + 140.0 * edges[0] * edges[1] + rng.normal(0.0, 1.5, x.shape)
        images.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    np.save(path, np.array(images))


def test_every_example_is_covered():
    assert set(examples()) == {*PLUGINS, "option"}


@pytest.mark.timeout(900)
def test_four_plugins_reach_the_report(tmp_path):
    for name in PLUGINS:
        (tmp_path / f"{name}.py").write_text(examples()[name], encoding="utf-8")
    videos, out = tmp_path / "videos", tmp_path / "out"
    videos.mkdir()
    write_clip(videos / "take.npy")
    (videos / "experiment.toml").write_text(SETTINGS.lstrip(), encoding="utf-8")
    command = [sys.executable, "-m", "modalcam", "run", videos, "-o", out, "--jobs", "1"]
    command += [part for name in PLUGINS for part in ("--plugin", name)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(tmp_path)])}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=840, check=False)
    assert done.returncode == 0, done.stderr
    report = (out / "report.html").read_text(encoding="utf-8")
    # the reader by its codec, the kind by its marker's name, the damping model by its name and colour
    for words in ("take.npy", "<dd>npy, ", "square1", "ean damping", "#2b6e4f"):
        assert words in report, words
    (frequency, *_) = (out / "frequencies.txt").read_text(encoding="utf-8").splitlines()
    assert float(frequency.removesuffix(" Hz")) == pytest.approx(10.2, abs=0.01)


def test_an_option_is_documented_and_checked_by_its_field():
    made = {}
    exec(examples()["option"], made)  # noqa: S102 - our own document
    section = made["ClampWithGap"]
    beam = create_model("Beam", __base__=BeamConfig, clamp=(section | None, None))
    experiment = create_model("Experiment", __base__=ExperimentConfig, beam=(beam | None, None))
    assert "#gap_mm = 0.05" in commented_toml(experiment)
    assert "| `gap_mm` | number ≥ 0 | mm | `0.0` | Play between clamp and beam. |" in markdown(experiment)
    with pytest.raises(ValidationError, match="greater than or equal to 0"):
        section(gap_mm=-1.0)

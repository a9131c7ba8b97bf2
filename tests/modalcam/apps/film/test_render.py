"""``modalcam render OUT``: the updated beam of a finished run, rendered with the camera of the recording."""

import shutil

import numpy as np
import pytest
from kit.films import FPS, FRAMES, HEIGHT, ONSET_S, WIDTH, decay_px, luma
from support.render_truth import centroid

from modalcam.apps.film import SimulatedFootage, film_run
from modalcam.commands import Options
from modalcam.common import InputError
from modalcam.config import ExperimentConfig
from modalcam.pipeline import Progress, load_run


def test_the_rendered_beam_moves_as_the_recorded_one(decay_run, tmp_path, monkeypatch):
    # Only saved frames are used: the recording is not available.
    shutil.copytree(decay_run / "out", tmp_path / "out")
    options = Options(tmp_path / "out")
    (recording,) = load_run(options.out).recordings
    found = recording.identification
    assert isinstance(recording.added["simulated"], SimulatedFootage)

    path = tmp_path / "simulated.avi"
    count = film_run(options, None, path, Progress())
    first = FRAMES - count
    assert first == np.searchsorted(np.arange(FRAMES) / FPS, found.onset.fit_from_s)
    film = list(luma(path))
    assert [frame.shape for frame in film] == [(HEIGHT, WIDTH)] * count
    # Lines of pixels across the dot are symmetric about its centre.
    middle = np.array([centroid(np.where(f < 190.0, f, 200.0)[12:21], 200.0)[0] for f in film])
    truth = 32.0 + decay_px(np.arange(first, FRAMES) / FPS)
    # With edge pixels clipped at 190 of 200, the centre has an error of a few hundredths of a pixel. The amplitude is
    # 4 px and halves in 0.7 s, so a wrong damping model, sign or phase exceeds the limit.
    assert np.sqrt(np.mean((middle - truth) ** 2)) < 0.06
    assert found.onset.fit_from_s > ONSET_S - 0.02
    again = tmp_path / "again.avi"
    film_run(options, "take", again, Progress())
    assert again.read_bytes() == path.read_bytes()
    # The exposure of a frame at the onset would begin before the simulation does.
    stated = ExperimentConfig.for_recording
    given = {"exposure_s": 2.0 / FPS}
    monkeypatch.setattr(ExperimentConfig, "for_recording", lambda *one: stated(*one).model_copy(update=given))
    assert film_run(options, "take", again, Progress()) == count - 1
    with pytest.raises(InputError, match="there is no recording other; it holds take"):
        film_run(options, "other", again, Progress())

"""``modalcam render OUT``: the updated beam of a finished run, filmed as the recording was."""

from contextlib import contextmanager

import av
import numpy as np
import pytest
from support.decay_clip import FPS, FRAMES, HEIGHT, ONSET_S, WIDTH, swing_px, write_decay
from support.render_truth import centroid
from support.worker_tasks import Inline

from modalcam.commands import Options, run
from modalcam.errors import InputError
from modalcam.execution.local import Limits
from modalcam.execution.pool import WorkerPool
from modalcam.execution.progress import Silent
from modalcam.render import film_run
from modalcam.video.results import SimulatedFootage


@contextmanager
def inline_pool(jobs, limits=None, **_):
    yield WorkerPool(Inline(), limits or Limits())


def frames_of(path):
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            plane = frame.planes[0]
            rows = np.frombuffer(plane, dtype=np.uint8).reshape(-1, plane.line_size)
            yield rows[: frame.height, : frame.width].astype(float)


def test_the_rendered_beam_moves_as_the_recorded_one(monkeypatch, tmp_path):
    monkeypatch.setattr("modalcam.commands.worker_pool", inline_pool)
    monkeypatch.setattr("modalcam.commands._write_files", lambda _, result, *__: result)
    (tmp_path / "videos").mkdir()
    write_decay(tmp_path / "videos")
    options = Options(tmp_path / "out")
    result = run(tmp_path / "videos", options, Silent())
    found = result.recordings[0].identification
    assert isinstance(result.recordings[0].simulated_footage, SimulatedFootage)
    # The frames are those that were saved: the recording itself is not there any more.
    (tmp_path / "videos" / "take.mkv").unlink()

    path = tmp_path / "twin.avi"
    count = film_run(options, None, path, Silent())
    first = FRAMES - count
    assert first == np.searchsorted(np.arange(FRAMES) / FPS, found.onset.fit_from_s)
    film = list(frames_of(path))
    assert [frame.shape for frame in film] == [(HEIGHT, WIDTH)] * count
    # Lines across the dot are symmetric about its centre, wherever the strip is.
    middle = np.array([centroid(np.where(f < 190.0, f, 200.0)[12:21], 200.0)[0] for f in film])
    truth = 32.0 + swing_px(np.arange(first, FRAMES) / FPS)
    # A dot whose edge pixels are cut at 190 of 200 is found to some hundredths; a wrong damping model, sign or phase
    # would show in the amplitude of 4 px, of which half is gone in 0.7 s.
    assert np.sqrt(np.mean((middle - truth) ** 2)) < 0.06
    assert found.onset.fit_from_s > ONSET_S - 0.02
    again = tmp_path / "again.avi"
    film_run(options, "take", again, Silent())
    assert again.read_bytes() == path.read_bytes()
    with pytest.raises(InputError, match="there is no recording other; it holds take"):
        film_run(options, "other", again, Silent())

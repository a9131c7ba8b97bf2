"""Footage of the beam of a configuration, and the file of its true positions."""

import av
import numpy as np
import pytest
from kit.beams import experiment

from modalcam.apps.film import film_config
from modalcam.common import ConfigError
from modalcam.pipeline import Progress
from sim.render import RecordingPlan

BEAM = {"length_mm": 60.0, "thickness_mm": 2.0, "density_kg_m3": 1200.0, "elastic_modulus_mpa": 30.0}
CONFIG = experiment(
    "[camera]\nfps = 200.0\nmm_per_px = 0.5\nexposure_s = 1e-3\n",
    '[markers]\nkind = "blob"\nsize_mm = 8.0\npositions_mm = [25.0, 55.0]\n',
    **BEAM,
    elements=4,
)
PLAN = RecordingPlan(mode_number=1, tip_amplitude_m=3e-3, shake_s=0.02, decay_s=0.03)


@pytest.fixture
def film(tmp_path):
    config = tmp_path / "experiment.toml"
    config.write_text(CONFIG)

    def made(name, **options):
        path, truth = tmp_path / name, tmp_path / f"{name}.npz"
        film_config(config, path, PLAN, 0.01, 3, Progress(), truth=truth, **options)
        with av.open(str(path)) as container:
            frames = [f.to_ndarray(format="gray").astype(float) for f in container.decode(video=0)]
        with np.load(truth, allow_pickle=False) as saved:
            return frames, dict(saved), truth.read_bytes()

    return made


def rows_centre(frame, x, y, half):
    """Centroid of the dark pixels around (x, y) in rows within 3 px: the background is that of the window's sides."""
    columns = np.arange(round(x) - half, round(x) + half + 1)
    window = frame[round(y) - 3 : round(y) + 4, columns]
    weight = np.mean([window[:, 0], window[:, -1]]) - window
    weight = np.where(weight > 20.0, weight, 0.0)
    return float(np.sum(weight * columns) / np.sum(weight))


@pytest.mark.parametrize(("bare", "half"), [(True, 9), (False, 13)])
def test_true_positions_belong_to_the_frames(film, bare, half):
    frames, truth, _ = film("film.avi", bare=bare)
    assert len(frames) == truth["time_s"].size == 11
    assert truth["time_s"] == pytest.approx(np.arange(11) / 200.0)
    assert truth["onset_s"] == pytest.approx(0.02)
    if bare:
        assert truth["position_mm"] == pytest.approx([*np.arange(0.0, 59.0, 2.0), 60.0])
        assert np.hypot(np.diff(truth["x_px"]), np.diff(truth["y_px"])) == pytest.approx(4.0, abs=0.01)
    else:
        assert truth["position_mm"].tolist() == [25.0, 55.0]
    k = int(np.argmin(np.abs(truth["position_mm"] - 55.0)))
    at = truth["x_px"][:, k], truth["y_px"][:, k]
    assert np.ptp(at[0]) > 6.0
    found = [rows_centre(f, x, y, half) for f, x, y in zip(frames, *at, strict=True)]
    # A reflection beside the middle and a texture move the centroid of a bare strip by tenths of a pixel, noise and
    # compression by hundredths; the motion in one frame is 2 px.
    assert np.max(np.abs(np.array(found) - at[0])) < (0.5 if bare else 0.15)


def test_same_seed_gives_the_same_truth_and_a_bare_beam_needs_no_positions(film, tmp_path):
    first, second = film("a.avi", bare=True), film("b.avi", bare=True)
    assert first[2] == second[2]
    assert all(np.array_equal(a, b) for a, b in zip(first[0], second[0], strict=True))
    config = tmp_path / "bare.toml"
    config.write_text(CONFIG.replace("fps = 200.0", ""))
    with pytest.raises(ConfigError, match=r"camera\.fps and camera\.mm_per_px are needed"):
        film_config(config, tmp_path / "c.avi", PLAN, 0.01, 3, Progress(), bare=True)

import json
from fractions import Fraction

import numpy as np
import pytest

from modal_id.results import FailedIdentification, Onset
from modalcam.errors import InputError
from modalcam.store import load, save
from tracker.series import Clock, DecodeReport, FailedTracking, MarkerTracks, Scale


def sample_tracks():
    rng = np.random.default_rng(1)
    x = rng.normal(size=(5, 2))
    x[2, 1] = np.nan
    return MarkerTracks(
        recording="a",
        markers=("m1", "m2"),
        frame=np.arange(5),
        time_s=np.arange(5) / 3.0,
        x_px=x,
        y_px=x + 1,
        sd_x_px=np.abs(x),
        sd_y_px=np.abs(x),
        flags=np.zeros((5, 2), dtype=np.uint32),
        positions_mm=np.array([2.0, np.nan]),
        scale=Scale(0.1, float("nan"), "user"),
        clock=Clock("user", Fraction(30000, 1001), None, ("note",)),
        decode=DecodeReport("mjpeg", "gray", 10, 20, 8, 5, 5, 0, lossy=True),
    )


def equal(a, b):
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind in "fc")
    if hasattr(a, "__dataclass_fields__"):
        return type(a) is type(b) and all(equal(getattr(a, f), getattr(b, f)) for f in a.__dataclass_fields__)
    if isinstance(a, float) and np.isnan(a):
        return isinstance(b, float) and np.isnan(b)
    return a == b


@pytest.mark.parametrize(
    "value",
    [
        sample_tracks(),
        FailedTracking("a", "reason", np.zeros((2, 3), dtype=np.uint8)),
        FailedIdentification("a", "reason"),
        Onset(0.1, float("inf"), 0.2, "user", 1.0),
    ],
)
def test_round_trip(tmp_path, value):
    path = tmp_path / "x.npz"
    save(path, "key", value)
    assert equal(load(path, "key"), value)
    assert equal(load(path), value)
    assert load(path, "another key") is None
    assert [p.name for p in tmp_path.iterdir()] == ["x.npz"]


def test_same_value_same_bytes(tmp_path):
    for name in ["a.npz", "b.npz"]:
        save(tmp_path / name, "key", sample_tracks())
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_absent_damaged_and_foreign_files(tmp_path):
    assert load(tmp_path / "absent.npz", "key") is None
    path = tmp_path / "x.npz"
    save(path, "key", sample_tracks())
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="--force"):
        load(path, "key")
    tree = {"format": "modalcam-result-1", "key": "key", "value": {"class": "Popen", "fields": {}}}
    np.savez(path, tree=np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8))
    with pytest.raises(InputError, match="damaged"):
        load(path, "key")


def test_what_cannot_be_stored_is_refused(tmp_path):
    with pytest.raises(TypeError, match="cannot store"):
        save(tmp_path / "x.npz", "key", object())
    assert list(tmp_path.iterdir()) == []

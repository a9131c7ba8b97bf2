import io
import json
import zipfile
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from kit.tracks import rectified_tracks, sample_tracks

from modal_id import FailedMode, Onset
from modalcam import plugins
from modalcam.common import InputError
from modalcam.config import RecordingConfig
from modalcam.pipeline import Cache, digest, load, save
from sim import paper_beam
from sim.updating import MeasuredModes, MeasuredShape, UpdatingSettings, update
from tracker import FailedTracking, Failure


@dataclass(frozen=True)
class MeanShift:
    """A result class of a module without a list of result classes."""

    value: float
    more: tuple


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
        rectified_tracks(),
        FailedTracking("reason", "a", first_frame=np.zeros((2, 3), dtype=np.uint8)),
        Failure("reason", "a"),
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


def test_updating_is_reproducible_and_loaded_unchanged(tmp_path):
    at = np.array([0.1, 0.3, 0.5])
    shape = MeasuredShape(1, at, np.array([0.1, 0.5, 1.0]), np.full(3, np.nan))
    measured = MeasuredModes(np.array([1, 2]), np.array([1.85, 10.2]), np.array([1e-4, np.nan]), (shape,))
    once, again = (update(paper_beam(elements=4), measured, UpdatingSettings(draws=5)) for _ in range(2))
    assert digest(once) == digest(again)
    save(tmp_path / "x.npz", "key", once)
    back = load(tmp_path / "x.npz", "key")
    assert digest(back) == digest(once)
    assert equal(back.bayesian, once.bayesian)
    save(tmp_path / "y.npz", "key", Failure("reason"))
    assert load(tmp_path / "y.npz", "key") == Failure("reason")


def test_missing_damaged_and_other_files(tmp_path):
    assert load(tmp_path / "absent.npz", "key") is None
    path = tmp_path / "x.npz"
    save(path, "key", sample_tracks())
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="--force"):
        load(path, "key")


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("subprocess:Popen", "not a class of modalcam"),
        ("modalcam_of_another:Popen", "not a class of modalcam"),
        ("modalcam.__main__:main", "not a class of modalcam"),
        ("modalcam.pipeline.cache:load", "not a frozen dataclass"),
        ("modalcam.pipeline.cache:importlib.abc.Loader", "not a frozen dataclass"),
        ("modalcam.pipeline.cache:Cache", "not a frozen dataclass"),
        ("modalcam.pipeline.cache:Absent", "no attribute"),
    ],
)
def test_only_dataclasses_of_the_program_are_loaded(tmp_path, kind, words):
    tree = {"format": "modalcam-result-2", "key": "key", "value": {"class": kind, "fields": {}}}
    np.savez(tmp_path / "x.npz", tree=np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8))
    with pytest.raises(InputError, match=f"damaged.*{words}"):
        load(tmp_path / "x.npz", "key")


def test_a_field_of_another_type_is_damage(tmp_path):
    path = tmp_path / "x.npz"
    for value in (Failure(5, "a"), FailedMode(5), Onset("soon", float("inf"), 0.2, "user", 1.0)):
        save(path, "key", value)
        with pytest.raises(InputError, match=r"damaged.*(reason: expected str|time_s: expected float)"):
            load(path, "key")


@pytest.mark.parametrize("announced", [10**13, 14 * 10**6])
def test_a_small_file_does_not_fill_the_memory(tmp_path, announced):
    path = tmp_path / "x.npz"
    save(path, "key", (np.zeros(3),))
    with zipfile.ZipFile(path) as archive:
        tree = archive.read("tree.npy")
    header = io.BytesIO()
    given = {"descr": "<f8", "fortran_order": False, "shape": (announced,)}
    np.lib.format.write_array_header_1_0(header, given)
    zeros = bytes(1 if announced > 10**9 else 8 * announced)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("tree.npy", tree)
        archive.writestr("a0.npy", header.getvalue() + zeros)
    with pytest.raises(InputError, match=r"damaged result.*(bytes that expand to 1|allocate)"):
        load(path, "key")


def test_a_result_in_another_format_is_ignored(tmp_path):
    tree = {"format": "modalcam-result-1", "key": "key", "value": 1}
    np.savez(tmp_path / "x.npz", tree=np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8))
    assert load(tmp_path / "x.npz", "key") is None


def test_a_class_without_a_list_of_classes_and_a_configuration_are_stored(tmp_path):
    for value in (MeanShift(1.5, (1, "a")), RecordingConfig(file="a.avi", fps=Fraction(30000, 1001))):
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(plugins._LOADED, MeanShift.__module__, "")
            save(tmp_path / "x.npz", "key", value)
            assert load(tmp_path / "x.npz", "key") == value
    with pytest.raises(TypeError, match="cannot store a MeanShift"):
        save(tmp_path / "x.npz", "key", MeanShift(1.5, ()))


@pytest.mark.parametrize("value", ["<svg>µ</svg>", b"\x89PNG\x00", (1.5, {"a": np.arange(3)})])
def test_a_value_is_computed_once_for_each_key(tmp_path, value):
    made = []

    def make():
        made.append(1)
        return value

    cache = Cache(tmp_path / "figures")
    for _ in range(2):
        assert digest(cache.cached("aa", make)) == digest(value)
    assert len(made) == 1
    cache.cached("bb", make)
    next_run = Cache(tmp_path / "figures")
    next_run.cached("bb", make)
    assert len(made) == 2
    (tmp_path / "figures" / "bb.npz").write_bytes(b"damaged")
    assert digest(next_run.cached("bb", make)) == digest(value)
    assert len(made) == 3
    next_run.drop_unused()
    assert [path.name for path in (tmp_path / "figures").iterdir()] == ["bb.npz"]


def test_values_that_cannot_be_stored_are_rejected(tmp_path):
    with pytest.raises(TypeError, match="cannot store"):
        save(tmp_path / "x.npz", "key", object())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "content",
    [b"no array", b"\x93NUMPY\x01\x00\x10\x00{'descr': '<f8', (", b"\x93NUMPY\x01\x00\x07\x00{[]: 1}"],
)
def test_a_member_that_is_no_array_is_damage(tmp_path, content):
    path = tmp_path / "a.npz"
    save(path, "key", (np.arange(3.0),))
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data if name.startswith("tree") else content)
    with pytest.raises(InputError, match="damaged result"):
        load(path, "key")

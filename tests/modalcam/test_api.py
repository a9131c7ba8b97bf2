"""The public API: its examples give the documented output, it imports quickly, failures raise with a reason."""

import contextlib
import doctest
import importlib
import io
import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from kit.identified import in_sd
from matplotlib.figure import Figure
from support.paths import ROOT, SAMPLES

import modalcam as mc


@pytest.fixture
def in_the_repository(monkeypatch):
    monkeypatch.chdir(ROOT)


@pytest.fixture(scope="module")
def readme():
    """Variables and output of the README's example."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    code = re.search(r"<!-- example -->\n```python\n(.*?)```", text, re.DOTALL)[1]
    names, output = {}, io.StringIO()
    with contextlib.chdir(ROOT), contextlib.redirect_stdout(output):
        exec(compile(code, "README.md", "exec"), names)  # noqa: S102 - the README is trusted
    return names, output.getvalue()


@pytest.mark.parametrize("module", ["modalcam", *sorted({module for module, _ in mc._SOURCES.values()})])
def test_examples_give_the_documented_output(module, in_the_repository, readme):
    # the examples start from the tracks of the README's example
    given = {"tracks": readme[0]["tracks"]}
    failed, tried = doctest.testmod(importlib.import_module(module), verbose=False, extraglobs=given)
    assert not failed, f"{failed} of {tried} examples of {module} give another output"


def test_every_public_function_has_an_example():
    names = [name for name in mc.__all__ if name[0] != "_" and not name.endswith("Error")]
    without = [name for name in names if ">>>" not in (getattr(mc, name).__doc__ or "")]
    assert len(names) >= 10
    assert not without, f"public names without an example in their docstring: {without}"


def test_the_readme_example_finds_the_sample(readme):
    names, output = readme
    truth = json.loads((SAMPLES / "truth.json").read_text())
    wanted = next(entry for entry in truth["recordings"] if entry["file"] == "mode4.avi")
    found = names["found"].target
    assert found.number == 4
    # the true value is that at small amplitude; the sd of the flagged mode includes the amplitude dependence
    assert np.max(np.abs(in_sd(found, wanted["frequency_hz"], wanted["damping_ratio"]))) < 5, found
    assert output == f"{found.frequency_hz:.2f} Hz, damping ratio {100 * found.damping_ratio:.2f} %\n"


@pytest.fixture(scope="module")
def results(readme):
    """One result of each public function of the way from film to simulation."""
    found, beam = readme[0]["found"], readme[0]["beam"]
    decay = mc.simulate(beam, 0.01, tip_amplitude_mm=1.0, duration_s=0.1)
    modes = mc.modes(beam, 2), decay, decay.trajectory
    return readme[0]["tracks"], found.series, found, found.target, found.target.posterior, *modes


def test_results_are_shown_briefly_and_state_their_units(results):
    """A name that ends in a unit says what the attributes must say."""
    units = {"s": "s", "hz": "Hz", "mm": "mm", "px": "px", "rad": "rad", "ratio": "1"}
    for result in results:
        assert len(repr(result)) < 500
        assert result._repr_html_().count("<tr") <= 12, "of a long table, ten rows"
        table = result.to_dataframe()
        named = {name: units[end] for name in table if (end := name.rpartition("_")[2]) in units}
        assert named
        assert table.attrs["units"].items() >= named.items()
        axes = result.plot(Figure().add_subplot())
        drawn = [label for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
        assert len(drawn) == 2 or not axes.get_yticks().size, "a histogram has no scale"
        assert all(re.search(r"\((s|Hz|mm)\)|ratio|shape", label) for label in drawn)


def test_series_and_draws_are_datasets(results):
    pytest.importorskip("xarray", reason="the extra modalcam[xarray] is not installed")
    series, posterior = results[1].to_xarray(), results[4].to_xarray()
    np.testing.assert_array_equal(series["sd"].sel(channel="m6"), results[1].sd[:, 5])
    assert (series["series"].attrs, series["time"].attrs) == ({"units": "mm"}, {"units": "s"})
    np.testing.assert_array_equal(posterior["damping_ratio"].sel(chain=1), results[4].damping_ratio[1])


@pytest.mark.parametrize("name", ["tracker.py", "modal_id.py", "sim/__init__.py"])
def test_a_module_that_shadows_a_package_is_reported(tmp_path, name):
    module = tmp_path / name
    module.parent.mkdir(exist_ok=True)
    module.write_text("")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    command = [sys.executable, "-c", "import modalcam"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, cwd=tmp_path)
    assert done.returncode != 0
    assert str(module) in done.stderr
    assert "Rename that file or folder" in done.stderr


def test_an_unknown_name_lists_the_public_ones():
    with pytest.raises(AttributeError, match="public names: track, displacement, identify"):
        _ = mc.trak
    assert {"track", "identify", "run"} <= set(dir(mc))
    assert not {"Path", "Any", "importlib"} & set(dir(mc)), "completion shows what is public"


def test_tracking_without_a_recording_raises_the_reason(tmp_path):
    path = tmp_path / "empty.avi"
    path.write_bytes(b"")
    with pytest.raises(mc.TrackingError, match=r"empty\.avi: "):
        mc.track(path, fps=500.0)


def test_noise_has_no_mode():
    t = np.arange(1000) / 500.0
    with pytest.raises(mc.IdentificationError, match="series: "):
        mc.identify(t, np.random.default_rng(5).standard_normal(t.size))


@pytest.mark.parametrize(
    ("t", "y", "text"),
    [
        ([0.0, 0.1, 0.2], None, "no values"),
        ([0.0, 0.1, 0.2], [1.0, 2.0], "expected n times"),
        (
            [0.0, 0.1, 0.2],
            [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]],
            "the values are transposed: give their transpose, y.T",
        ),
        ([0.0, 0.2, 0.1], [1.0, 2.0, 3.0], "strictly increasing"),
    ],
)
def test_inconsistent_times_and_values_are_rejected(t, y, text):
    with pytest.raises(ValueError, match=text):
        mc.identify(t, y)


def test_lists_and_several_channels_are_accepted():
    t = np.arange(1500) / 500.0
    rng = np.random.default_rng(3)
    omega_n = 2 * np.pi * 12
    decay = np.exp(-0.02 * omega_n * t) * np.cos(omega_n * np.sqrt(1 - 0.02**2) * t)
    y = decay[:, None] * [1.0, 0.5] + 0.01 * rng.standard_normal((t.size, 2))
    found = mc.identify(t.tolist(), y.tolist(), positions_mm=[200, 400], frequency_hz=12)
    mode = found.target
    assert np.max(np.abs(in_sd(mode, 12.0, 0.02))) < 5, mode

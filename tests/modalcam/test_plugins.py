"""Plugins: named modules and entry points, in this process and in workers, as inputs of the results."""

import importlib.metadata

import pytest

from modalcam import plugins
from modalcam.common import InputError
from modalcam.pipeline import code_state, worker_pool
from modalcam.plugins import is_ours, load_plugins, loaded_plugins, source_sha256


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder on the import path; plugins loaded in the test are unloaded afterwards."""
    monkeypatch.setattr(plugins, "_LOADED", {})
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_a_named_module_is_loaded_once_and_is_part_of_the_code(folder):
    (folder / "toy_once.py").write_text("LOADED = []\n")
    before = code_state("modalcam.common")
    ((name, sha256),) = load_plugins(["toy_once"])
    assert (name, len(sha256)) == ("toy_once", 64)
    assert load_plugins(["toy_once"]) == loaded_plugins() == ((name, sha256),)
    assert code_state("modalcam.common") != before
    assert is_ours("toy_once")
    assert is_ours("sim.beam")
    assert not is_ours("toy_once_more")


def test_the_source_of_a_package_includes_all_its_files(folder):
    hashes = []
    for name, text in [("toy_one", "A = 1\n"), ("toy_two", "A = 2\n")]:
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text("")
        (folder / name / "models.py").write_text(text)
        hashes.append(dict(load_plugins([name]))[name])
    assert hashes[0] != hashes[1]


@pytest.mark.parametrize("file", ["templates/page.html.j2", "style.css", "zoom.js", "terms.toml"])
def test_the_source_of_a_package_includes_what_its_pages_are_made_from(folder, file):
    (folder / "toy_page" / "templates").mkdir(parents=True)
    (folder / "toy_page" / "__init__.py").write_text("")
    path = folder / "toy_page" / file
    path.write_text("one")
    before = source_sha256("toy_page")
    assert source_sha256("toy_page") == before
    (folder / "toy_page" / "__init__.cpython-311.pyc").write_bytes(b"compiled")
    assert source_sha256("toy_page") == before, "compiled code is not source: a run would never be up to date"
    path.write_text("two")
    assert source_sha256("toy_page") != before, f"a report made with another {file} would pass for up to date"


def test_plugins_of_installed_distributions_are_loaded(folder, monkeypatch):
    (folder / "toy_installed.py").write_text("")
    entry = importlib.metadata.EntryPoint("toy", "toy_installed", plugins.GROUP)
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [entry])
    assert [name for name, _ in load_plugins()] == ["toy_installed"]


@pytest.mark.parametrize(
    ("text", "words"), [(None, "No module named"), ("1 / 0\n", "ZeroDivisionError: division by zero")]
)
def test_a_plugin_that_cannot_be_imported_is_an_error_with_its_name(folder, text, words):
    if text is not None:
        (folder / "toy_broken.py").write_text(text)
    with pytest.raises(InputError, match=f"plugin toy_broken: cannot be imported .*{words}"):
        load_plugins(["toy_broken"])
    assert loaded_plugins() == ()


def plugins_of_worker(_):
    return loaded_plugins()


def test_every_worker_loads_the_plugins_before_its_first_task(folder):
    (folder / "toy_worker.py").write_text("")
    expected = load_plugins(["toy_worker"])
    with worker_pool(1, plugins=("toy_worker",)) as pool:
        assert pool.map(plugins_of_worker, [None]) == [expected]

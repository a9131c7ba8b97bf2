"""The page of thresholds and the measurement of their effects."""

import dataclasses
import importlib
import math
from pathlib import Path

import pytest
from support.paths import APPS, ROOT

from benchmarks.tuning import (
    EFFECTS,
    FACTORS,
    SOURCES,
    Constant,
    change,
    constants,
    effects,
    frozen,
    modules,
    page,
    stated,
)
from benchmarks.tuning_battery import AFFECTED, PARTS, Found, affected, difference

EVERY = [(module, constant) for module in modules() for constant in constants(module)]


@pytest.mark.skipif(not APPS, reason="modalcam/apps was deleted")
def test_the_page_is_up_to_date():
    stated = (ROOT / "docs" / "tuning.md").read_text(encoding="utf-8")
    assert stated == page(effects(EFFECTS)), "run python -m benchmarks.tuning --page docs/tuning.md"


@pytest.mark.parametrize("module", modules())
def test_every_threshold_says_what_it_is_and_why(module):
    defined = importlib.import_module(module)
    assert defined.Tuning() == defined.TUNING
    with pytest.raises(AttributeError):
        defined.TUNING.another = 1.0
    for constant in constants(module):
        assert constant.source in SOURCES, constant.name
        assert constant.unit, constant.name
        assert "]" not in constant.unit, constant.name
        assert min(len(constant.meaning), len(constant.why)) > 3, constant.name
        assert math.isfinite(constant.value), constant.name


def test_what_stands_above_a_field_is_read():
    source = """
    class Tuning:
        #: [px] shift beyond which
        #: a marker is lost
        #: physics: half its
        #: width
        lost: float = 1.0
        #: [1] share
        share: float = 0.5
    """
    assert stated(source) == {
        "lost": ("px", "shift beyond which a marker is lost", "physics", "half its width"),
        "share": ("1", "share", "convention", "chosen; effect not measured"),
    }


def test_every_module_has_a_part_of_the_battery():
    assert EVERY
    assert {part for module, _ in EVERY for part in affected(module)} <= PARTS.keys()
    assert all(part in PARTS for parts in AFFECTED.values() for part in parts)


def test_counts_change_by_one_at_least():
    def constant(value):
        return Constant("sim.beam.ancf", "x", value, "1", "", "physics", "")

    assert [constant(v).changed(f) for v in (1, 3, 400) for f in FACTORS] == [0, 2, 2, 4, 280, 560]
    assert constant(0.5).changed(0.7) == pytest.approx(0.35)


def test_a_changed_threshold_is_seen_by_its_module_alone(monkeypatch):
    monkeypatch.setattr(dataclasses, "dataclass", dataclasses.dataclass)
    change("a.module", "second", 7.0)
    source = (
        "from dataclasses import dataclass\n"
        "@dataclass(frozen=True)\nclass Tuning:\n    first: float = 1.0\n    second: float = 2.0\n"
    )
    for name, expected in (("a.module", (1.0, 7.0)), ("another", (1.0, 2.0))):
        module = {"__name__": name}
        exec(source, module)  # noqa: S102
        assert dataclasses.astuple(module["Tuning"]()) == expected


def test_values_in_kernels_are_found():
    held = {f"{module}.{c.name}" for module, c in EVERY if frozen(c)}
    assert {"sim.dynamics.march.fading", "sim.render.kernels.reach"} <= held
    assert "sim.beam.ancf.held_by" not in held


def test_a_difference_is_in_standard_deviations():
    one = Found(frequency={"a": (10.0, 0.1)}, positions_px={"film": [0.0, 0.0]}, lost=1)
    other = Found(frequency={"a": (10.2, 0.2)}, positions_px={"film": [3.0, math.nan]}, lost=3, failures=1)
    found = difference(one, other)
    assert (found.frequency_sd, found.positions_px, found.lost) == (pytest.approx(2.0), 3.0, 2)
    assert not found.identical
    assert difference(one, one).identical


def test_the_table_holds_effects_of_known_thresholds():
    known = {(module, c.name) for module, c in EVERY}
    rows = effects(EFFECTS)
    assert {key[:2] for key in rows} <= known, "the table has thresholds that are gone: remove their rows"
    assert effects(Path("no such file")) == {}

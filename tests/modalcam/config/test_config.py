import re
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.beams import experiment
from pydantic import ValidationError

from modalcam.common import ConfigError
from modalcam.config import (
    BeamConfig,
    CameraConfig,
    ExperimentConfig,
    beam_properties,
    dump_config,
    load_config,
    parse_config,
    updating_settings,
)
from sim.beam import AncfBeam, beam_modes
from sim.updating import UpdatingSettings
from tracker import parse_fps, write_fps

EXAMPLE = experiment(
    """
[camera]
fps = 1000.0
mm_per_px = 1.0
exposure_s = 0.0005
[markers]
kind = "blob"
dictionary = "DICT_4X4_50"
size_mm = 12.0
positions_mm = [2.0, 90.0, 190.0, 290.0, 390.0, 490.0]
points_px = [[300.0, 120.0]]
reference = []
""",
    '[[recordings]]\nfile = "take_a.avi"\nmode = 1\nfps = 250.0\nonset_s = 0.40\n',
    orientation='"hanging"',
    elements=20,
)


@pytest.fixture
def write(tmp_path):
    def _write(text, encoding="utf-8"):
        path = tmp_path / "experiment.toml"
        path.write_bytes(text.encode(encoding))
        return path

    return _write


def test_a_configuration_is_read_and_resolved(write):
    config = load_config(write(EXAMPLE))
    listed = config.for_recording("take_a.avi")
    other = config.for_recording("other.avi")
    assert (listed.fps, listed.mode, listed.onset_s) == (Fraction(250), 1, 0.4)
    assert (other.fps, other.mode, other.onset_s) == (Fraction(1000), None, None)
    assert listed.mm_per_px == other.mm_per_px == 1.0
    assert listed.positions_mm == (2.0, 90.0, 190.0, 290.0, 390.0, 490.0)


def test_a_dumped_configuration_is_read_back_unchanged(write):
    config = load_config(write(EXAMPLE))
    assert load_config(write(dump_config(config))) == config


def test_empty_files_bom_and_crlf_are_accepted(write):
    assert load_config(write("")) == ExperimentConfig()
    crlf = "\ufeff" + EXAMPLE.replace("\n", "\r\n")
    assert load_config(write(crlf)) == load_config(write(EXAMPLE))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[camera]\nfsp = 1000", ["camera.fsp", "did you mean 'fps'"]),
        ("[beam]\nlenght_mm = 500", ["beam.lenght_mm", "did you mean 'length_mm'"]),
        ("[[recordings]]\nfile = 'a'\nmood = 1", ["recordings.1.mood", "did you mean 'mode'"]),
        ("[cameras]\nfps = 1", ["'cameras'", "did you mean 'camera'"]),
        ("[camera]\nfps = 0", ["camera.fps", "positive", "0"]),
        ("[camera]\nfps = -1", ["camera.fps", "positive"]),
        ("[camera]\nfps = nan", ["camera.fps", "positive"]),
        ("[camera]\nfps = inf", ["camera.fps", "positive"]),
        ("[camera]\nfps = true", ["camera.fps", "'true'"]),
        ("[camera]\nmm_per_px = true", ["camera.mm_per_px", "'true'"]),
        ("[markers]\npositions_mm = [1.0, true]", ["markers.positions_mm.2", "'true'"]),
        ("[[recordings]]\nfile='a'\nmode = true", ["recordings.1.mode", "'true'"]),
        ("[camera]\nmm_per_px = 1e9", ["camera.mm_per_px", "1000000"]),
        ("[[recordings]]\nfile='a'\nadd_hz = [1e-300]", ["recordings.1.add_hz.1", "1e-300"]),
        ("[camera]\nfps = '240fps'", ["camera.fps", "240fps"]),
        ("[camera]\nmm_per_px = 0.0", ["camera.mm_per_px", "greater than or equal"]),
        ("[markers]\nsize_mm = -2.0", ["markers.size_mm", "greater than or equal"]),
        ("[markers]\nkind = 'dots'", ["markers.kind", "blob"]),
        ("[beam]\nelements = 1", ["beam.elements"]),
        ("[[recordings]]\nmode = 1", ["recordings.1.file"]),
        ("[[recordings]]\nfile='a'\n[[recordings]]\nfile='a'", ["listed twice", "'a'"]),
        ("[[recordings]]\nfile='a'\nmode=1\ntarget_frequency_hz=2.0", ["not both"]),
        ("[camera]\nfps = 1\nfps = 2", ["not valid TOML"]),
    ],
)
def test_errors_name_the_key_and_the_expected_value(write, text, words):
    path = write(text)
    with pytest.raises(ConfigError) as info:
        load_config(path)
    for word in [str(path), *words]:
        assert word in str(info.value)


def test_unreadable_files_are_errors(write, tmp_path):
    with pytest.raises(ConfigError, match="UTF-8"):
        load_config(write("# caf\xe9", "latin-1"))
    big = tmp_path / "big.toml"
    big.write_bytes(b"#" * 2_000_000)
    with pytest.raises(ConfigError, match="at most"):
        load_config(big)
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(tmp_path / "absent.toml")


# Files state rates as fractions of two numbers of 32 bits; longer texts are refused.
@given(st.fractions(min_value=Fraction(1, 1000), max_value=10**9, max_denominator=2**32 - 1))
def test_frame_rates_are_exact(fps):
    assert parse_fps(str(fps)) == fps
    assert parse_fps(write_fps(fps)) == fps


def test_decimal_rates_are_exact():
    assert parse_fps(59.94) == Fraction(5994, 100)
    assert parse_fps("30000/1001") == Fraction(30000, 1001)


def test_the_command_line_rate_overrides_the_file():
    config = parse_config(
        {"camera": {"fps": 100}, "recordings": [{"file": "a", "fps": 5}]}, where="test"
    ).with_camera(CameraConfig(fps=2000))
    assert config.for_recording("a").fps == config.for_recording("b").fps == 2000


BEAM = {
    "length_mm": 300.0,
    "width_mm": 20.0,
    "thickness_mm": 2.0,
    "density_kg_m3": 2700.0,
    "elastic_modulus_mpa": 70000.0,
}


def test_clamp_angle_and_inertia_are_set_in_the_beam():
    beam = BeamConfig.model_validate(
        {
            **BEAM,
            "orientation": "angled",
            "angle_deg": 30.0,
            "clamp": {"rotation_n_m_rad": 300.0},
            "point_masses": [{"position_mm": 200.0, "mass_g": 5.0, "rotary_inertia_g_mm2": 40.0}],
        }
    )
    properties = beam_properties(beam)
    assert properties.angle_deg == 30.0
    assert properties.clamp.rotation_n_m_rad == 300.0
    assert properties.clamp.translation_n_m is None
    assert properties.point_masses[0].rotary_inertia_kg_m2 == pytest.approx(4e-8)
    soft = beam_modes(AncfBeam(properties), 1).frequency_hz[0]
    rigid = beam_modes(AncfBeam(beam_properties(beam.model_copy(update={"clamp": None}))), 1).frequency_hz[0]
    assert soft < rigid


def test_ends_are_set_in_the_beam_and_what_they_contradict_is_named():
    pinned = beam_properties(BeamConfig.model_validate({**BEAM, "ends": ["pinned", "pinned"]}))
    assert pinned.ends == ("pinned", "pinned")
    with pytest.raises(ConfigError, match=r"\[beam\]: .*weight.*'free' and 'free'"):
        beam_properties(BeamConfig.model_validate({**BEAM, "ends": ["free", "free"]}))


def test_a_change_of_section_begins_with_an_element_and_keeps_what_it_does_not_name():
    sections = [{"from_mm": 30, "thickness_mm": 3}, {"from_mm": 100.00001, "width_mm": 10}, {"from_mm": 270}]
    found = beam_properties(BeamConfig.model_validate({**BEAM, "elements": 30, "sections": sections}))
    assert (1e3 * found.thickness_m).round(9).tolist() == 3 * [2.0] + 7 * [3.0] + 20 * [2.0]
    assert (1e3 * found.width_m).round(9).tolist() == 10 * [20.0] + 17 * [10.0] + 3 * [20.0]


@pytest.mark.parametrize(
    ("starts", "words"),
    [
        ([40.0], "from_mm = 40 is no boundary of the 20 elements of 15 mm each; write 45, or elements = 30"),
        (
            [60.0, 47.0],
            "expected from_mm in rising order, below the length of the beam (300 mm); found 60, 47",
        ),
        ([30.0, 30.0], "in rising order"),
        ([300.0], "in rising order, below the length"),
    ],
)
def test_changes_of_section_that_no_mesh_has_are_refused(starts, words):
    sections = [{"from_mm": start, "width_mm": 1.0} for start in starts]
    with pytest.raises(ConfigError, match=re.escape(words)):
        beam_properties(BeamConfig.model_validate({**BEAM, "sections": sections}))
    with pytest.raises(ValidationError, match="if width_mm is in metres, write 20"):
        BeamConfig.model_validate({**BEAM, "sections": [{"from_mm": 150.0, "width_mm": 0.02}]})


@pytest.mark.parametrize("wrong", [{"orientation": "angled"}, {"angle_deg": 10.0}])
def test_an_angle_requires_orientation_angled(wrong):
    with pytest.raises(ValidationError, match="angle_deg"):
        BeamConfig.model_validate({**BEAM, **wrong})


def test_updating_settings_are_read_from_the_configuration(write):
    config = load_config(write(EXAMPLE + "[updating]\nbound = 0.05\nmodel_sd = 1e-3\n"))
    assert updating_settings(config.updating) == UpdatingSettings(bound=0.05, model_sd=1e-3)
    assert load_config(write(dump_config(config))) == config
    assert "updating" not in dump_config(load_config(write(EXAMPLE)))
    with pytest.raises(ConfigError, match="did you mean 'bound'"):
        load_config(write(EXAMPLE + "[updating]\nbounds = 0.05\n"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("# first\n[camera]\nfsp = 100\n", "line 3: unknown key 'camera.fsp'"),
        ("[camera]\nfps = 'fast'\n", "line 2: camera.fps:"),
        ("fsp = 1\n", "line 1: unknown key 'fsp'"),
        (
            '[[recordings]]\nfile = "a.avi"\n\n[[recordings]]\nfile = "b.avi"\n  mode = 0\n',
            "line 6: recordings.2.mode:",
        ),
        ('[camera]\n"fsp" = 100\n', "line 2: unknown key 'camera.fsp'"),
        ("camera = {fsp = 100}\n", "toml: unknown key 'camera.fsp'"),
    ],
)
def test_errors_name_the_line_of_a_key(write, text, words):
    with pytest.raises(ConfigError, match=re.escape(words)):
        load_config(write(text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("".join(f"unknown{k} = 1\n" for k in range(100)), "and 92 more"),
        ('[camera]\nmm_per_px = "' + "1" * 10_000 + 'x"\n', "camera.mm_per_px"),
        ("[beam]\nelements = 0x" + "f" * 5000 + "\n", "20000 bits"),
        ("a" * 10_000 + " = 1\n", "unknown key"),
    ],
)
def test_refusals_are_short_whatever_the_file_holds(tmp_path, text, words):
    path = tmp_path / "experiment.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words) as info:
        load_config(path)
    assert len(str(info.value)) < 1500 + len(str(path))

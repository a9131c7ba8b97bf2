"""Options are declared once; TOML template, documentation, help and checks are generated from their fields."""

import tomllib

import pytest
from pydantic import Field
from support.paths import ROOT

from modalcam.common import ConfigError
from modalcam.config import (
    CameraConfig,
    ExperimentConfig,
    commented_toml,
    dump_config,
    markdown,
    option,
    parse_config,
    sections,
    toml_value,
)
from tracker import Positive

OPTIONS = [(section, o) for section in sections() for o in section.options()]
NAMES = [f"{o.section}.{o.key}" for _, o in OPTIONS]
# Other keys that a key requires.
REQUIRED = {
    "beam.angle_deg": {"orientation": "angled"},
    "beam.sections.width_mm": {"from_mm": 1.0},
    "beam.sections.thickness_mm": {"from_mm": 1.0},
    "beam.point_masses.position_mm": {"mass_g": 1.0},
    "beam.point_masses.mass_g": {"position_mm": 1.0},
    "beam.point_masses.rotary_inertia_g_mm2": {"mass_g": 1.0, "position_mm": 1.0},
    "beam.clamp.translation_n_m": {"rotation_n_m_rad": 1.0},
}
OF_A_FILE = "leave_out input_file input_column input_unit mode target_frequency_hz reject_hz add_hz"
OF_A_FILE += " onset_s end_s components excitation output_only input_lag_ms"
REQUIRED |= {f"recordings.{key}": {"file": "a.avi"} for key in OF_A_FILE.split()}


def tree(section, values):
    """Nested tables with `values` in one section."""
    data = [values] if section.repeated else values
    for name in reversed(section.path.split(".")):
        data = {name: data}
    return data


@pytest.fixture(scope="module")
def written():
    """Every option as `modalcam init` writes it, and in the table of docs/configuration.md."""
    return commented_toml(), markdown()


@pytest.mark.parametrize(("section", "one"), OPTIONS, ids=NAMES)
def test_every_option_has_a_description_and_a_valid_example(section, one, written):
    assert one.field.description
    assert one.field.description.endswith(".")
    assert one.example is not None
    text, table = written
    assert (f"# {one.key}: " if section.path == "recordings" else f"#{one.key} = ") in text
    assert f"| `{one.key}` | " in table
    values = {**REQUIRED.get(f"{one.section}.{one.key}", {}), one.key: one.example}
    config = parse_config(tree(section, values), where="test")
    assert parse_config(tomllib.loads(dump_config(config)), where="test") == config
    if not one.field.is_required() and one.example != one.field.default:
        assert one.key in dump_config(config)


@pytest.mark.parametrize("section", list(sections()), ids=lambda section: section.path)
@pytest.mark.parametrize("position", [0, 1, -1])
def test_the_correct_key_is_suggested_for_a_misspelt_one(section, position):
    for key in section.model.model_fields:
        wrong = f"{key[:position]}x{key[position:]}" if position != -1 else f"{key}x"
        with pytest.raises(ConfigError, match=f"did you mean '{key}'"):
            parse_config(tree(section, {wrong: 1}), where="test")


def test_the_documentation_page_is_current():
    page = (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")
    assert page == markdown(), "run python docs/configuration.py"


def test_a_new_field_appears_in_the_generated_texts():
    class ToyCamera(CameraConfig):
        """Camera of this test."""

        baseline_mm: Positive | None = Field(
            default=None, description="Distance of two cameras.", examples=[7.5]
        )

    class ToyConfig(ExperimentConfig):
        camera: ToyCamera = ToyCamera()

    assert "# Distance of two cameras. (mm, > 0)\n#baseline_mm = 7.5\n" in commented_toml(ToyConfig)
    assert "| `baseline_mm` | number > 0 | mm |  | Distance of two cameras. |" in markdown(ToyConfig)
    assert ToyConfig.model_validate({"camera": {"baseline_mm": 2}}).camera.baseline_mm == 2.0
    assert "baseline_mm : default None" in ToyCamera.__doc__


def test_help_states_unit_and_limits():
    assert option("recordings.onset_s").help.endswith("detected when not given. (s, ≥ 0)")
    assert option("beam.elements").help == "Number of finite elements. (2 to 1000)"
    assert toml_value(option("air.drag_coefficient").example) == '"identify"'


def test_units_follow_from_the_keys():
    units = {name.rpartition(".")[2]: o.unit for name, (_, o) in zip(NAMES, OPTIONS, strict=True)}
    assert units["elastic_modulus_mpa"] == "MPa"
    assert units["density_kg_m3"] == "kg/m³"
    assert units["rotation_n_m_rad"] == "N m/rad"
    assert units["rotary_inertia_g_mm2"] == "g mm²"
    assert units["sd_mm_per_px"] == "mm/px"
    assert units["reference"] == units["models"] == units["bit_depth"] == ""

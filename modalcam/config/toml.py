"""Reading and writing `experiment.toml`, with errors that name the key and suggest the right one."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from modalcam.config.schema import DampingConfig, ExperimentConfig, LensConfig, PlanConfig, UpdatingConfig
from modalcam.errors import ConfigError
from tracker.options import problems

CONFIG_NAME = "experiment.toml"
MAX_CONFIG_BYTES = 1_000_000


def load_config(path: Path) -> ExperimentConfig:
    """Configuration from a TOML file.

    Raises
    ------
    ConfigError
        If the file cannot be read, is no TOML, or holds an unknown key or a value out of range; the text
        names file, key and what to write instead.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        msg = f"{path}: cannot be read ({error.strerror})"
        raise ConfigError(msg) from error
    if len(data) > MAX_CONFIG_BYTES:
        msg = f"{path}: expected a configuration of at most {MAX_CONFIG_BYTES} bytes, found {len(data)}"
        raise ConfigError(msg)
    return _with_lenses(parse_config(_toml(path, data), where=str(path)), path)


def _with_lenses(config: ExperimentConfig, path: Path) -> ExperimentConfig:
    """Put what lens files hold in place of their names, which are relative to the configuration's folder."""

    def resolved(section: Any) -> Any:
        if not isinstance(section.lens, str):
            return section
        return section.model_copy(update={"lens": _lens(path.parent / section.lens)})

    update = {"camera": resolved(config.camera), "recordings": tuple(map(resolved, config.recordings))}
    return config.model_copy(update=update)


def _lens(path: Path) -> LensConfig:
    try:
        data = path.read_bytes()
    except OSError as error:
        msg = f"{path}: the lens cannot be read ({error.strerror}); `modalcam calibrate` writes one"
        raise ConfigError(msg) from error
    try:
        return LensConfig.model_validate(_toml(path, data))
    except ValidationError as error:
        msg = f"{path}: not a lens as `modalcam calibrate` writes it: " + "; ".join(
            problems(error, LensConfig)
        )
        raise ConfigError(msg) from None


def _toml(path: Path, data: bytes) -> dict[str, Any]:
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        msg = f"{path}: expected UTF-8 text, found byte {data[error.start]:#04x} at offset {error.start}"
        raise ConfigError(msg) from error
    except tomllib.TOMLDecodeError as error:
        msg = f"{path}: not valid TOML: {error}"
        raise ConfigError(msg) from error


def parse_config(data: dict[str, Any], *, where: str) -> ExperimentConfig:
    """Configuration from parsed TOML; `where` names its source in errors.

    Raises
    ------
    ConfigError
        As `load_config`.
    """
    try:
        return ExperimentConfig.model_validate(data)
    except ValidationError as error:
        msg = f"{where}: " + "; ".join(problems(error, ExperimentConfig))
        raise ConfigError(msg) from None


def dump_config(config: ExperimentConfig) -> str:
    """TOML text of a configuration, without the keys that are not given."""
    sections = {"plan": PlanConfig(), "updating": UpdatingConfig(), "damping": DampingConfig()}
    unused = {name for name, default in sections.items() if getattr(config, name) == default}
    return tomli_w.dumps(config.model_dump(mode="json", exclude_none=True, exclude=unused))

"""`modalcam plan`: from a configuration to a plan."""

from __future__ import annotations

from pathlib import Path

from modalcam.config.toml import load_config
from modalcam.errors import ConfigError
from modalcam.execution.progress import Progress
from modalcam.planning.page import Plan
from modalcam.planning.predict import predict
from modalcam.planning.request import plan_request
from modalcam.planning.suggest import better_places, rates
from modalcam.planning.tried import Tried, try_all
from sim.beam.statics import BuckledBeamError


def make_plan(config_path: Path, *, trials: int, seed: int, jobs: int, progress: Progress) -> Plan:
    """Predict, suggest and, with `trials`, try out.

    Raises
    ------
    ConfigError
        If the configuration lacks what a plan needs, or its beam has not the modes, or buckles.
    """
    request = plan_request(load_config(config_path), config_path)
    try:
        modes = predict(request)
        places = better_places(request)
    except (ValueError, BuckledBeamError) as error:
        msg = f"{config_path}: {error}"
        raise ConfigError(msg) from error
    suggested = rates(request, tuple(m.frequency_hz for m in modes))
    tried: tuple[Tried, ...] = ()
    if trials:
        progress.begin("trying out", trials * len(request.modes))
        tried = try_all(
            request, trials, seed=seed, jobs=jobs, done=lambda k: progress.advance(f"trial {k + 1}")
        )
    return Plan(request, modes, places, suggested, tried)

"""From a configuration to a plan."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from modalcam.apps.plan.predict import predict
from modalcam.apps.plan.request import Plan, plan_request
from modalcam.apps.plan.trials import better_positions, frame_rates, run_trials
from modalcam.common import ConfigError
from modalcam.config import ExperimentConfig, load_config
from modalcam.pipeline import Progress
from sim.beam import BuckledBeamError, NoEquilibriumError


def plan(
    config: ExperimentConfig | Path | str,
    *,
    trials: int = 0,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> Plan:
    """Predict the intervals of an experiment before it is filmed.

    Parameters
    ----------
    config : ExperimentConfig, Path or str
        Configuration, or path of an `experiment.toml`. It needs `[beam]`, camera.fps, camera.mm_per_px and
        markers.positions_mm; rate, scale and markers may be given per recording instead.
    trials : int
        Recordings to render, track and identify for each mode; their scatter checks the prediction.
    seed : int
        Of the camera noise in the trials.
    jobs : int
        Worker processes for the trials; the result does not depend on it.
    progress : Progress or None
        Of the trials.

    Returns
    -------
    Plan

    Raises
    ------
    ConfigError
        If the configuration cannot be read or lacks a key, if the beam buckles or cannot carry its weight, if its mesh
        has too few modes, or if a number is one that no experiment has.

    Examples
    --------
    >>> import modalcam as mc
    >>> expected = mc.plan("sample_videos/experiment.toml").to_dataframe()
    >>> expected["frequency_hz"].round(2).tolist()
    [1.88, 10.58, 29.26, 57.15, 94.34]
    """
    source = "configuration" if isinstance(config, ExperimentConfig) else str(config)
    if not isinstance(config, ExperimentConfig):
        config = load_config(Path(config))
    request = plan_request(config, source)
    try:
        modes = predict(request)
        positions = better_positions(request)
    except (ValueError, BuckledBeamError, NoEquilibriumError) as error:
        msg = f"{source}: {error}"
        raise ConfigError(msg) from error
    found = Plan(request, modes, positions, frame_rates(modes))
    if not trials:
        return found
    if progress is not None:
        progress.begin("running trials", trials * len(modes))

    def done(k: int) -> None:
        if progress is not None:
            progress.advance(f"trial {k + 1}")

    return replace(found, trials=run_trials(request, trials, seed=seed, jobs=jobs, done=done))

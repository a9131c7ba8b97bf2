"""Posterior draws as NetCDF in the layout that ArviZ opens: group ``posterior``, dimensions chain and draw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

import modalcam
from modal_id.results import IdentifiedMode
from modalcam.storage.atomic import replacing


def write_posterior(path: Path, modes: tuple[IdentifiedMode, ...], recording: str) -> None:
    """Write the draws of all modes of a recording; one chain is one independent ensemble of emcee.

    Variables ``frequency_hz`` and ``damping_ratio`` have dimensions (chain, draw, mode). The coordinate ``mode`` is the
    beam's number where all modes have one, and counts them by frequency from 1 otherwise; ``mode_number`` is the
    beam's number, 0 where unknown. Where modes have different numbers of draws the last ones of each are kept.

    Raises
    ------
    ValueError
        If `modes` is empty.
    """
    if not modes:
        msg = "expected at least one identified mode, found none"
        raise ValueError(msg)
    draws = min(mode.posterior.frequency_hz.shape[1] for mode in modes)
    chains = modes[0].posterior.frequency_hz.shape[0]

    def stacked(name: str) -> np.ndarray:
        return np.stack([getattr(mode.posterior, name)[:, -draws:] for mode in modes], axis=-1)

    numbers = [mode.number or 0 for mode in modes]
    labels = numbers if all(numbers) and len(set(numbers)) == len(numbers) else list(range(1, len(modes) + 1))
    dims = ("chain", "draw", "mode")
    data = xr.Dataset(
        {
            "frequency_hz": (dims, stacked("frequency_hz"), {"units": "Hz", "long_name": "omega_n / 2 pi"}),
            "damping_ratio": (dims, stacked("damping_ratio"), {"units": "1", "long_name": "zeta"}),
        },
        coords={
            "chain": np.arange(chains),
            "draw": np.arange(draws),
            "mode": labels,
            "mode_number": ("mode", numbers),
        },
        attrs={
            "recording": recording,
            "inference_library": "emcee",
            "creation_library": f"modalcam {modalcam.__version__}",
        },
    )
    with replacing(path) as beside:
        data.to_netcdf(beside, group="posterior", engine="h5netcdf")

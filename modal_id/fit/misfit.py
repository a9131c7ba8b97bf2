"""Motion that a fit leaves unexplained at the frequencies of its strongest modes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data import AT_ONCE, row_blocks
from modal_id.fit.modal_fit import ModalFit
from modal_id.fit.position_errors import Omissions
from modal_id.solve import LinearSolution, ModeColumns, frequency_hz, solve_linear
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Windows in which the misfit of a decay is looked for, and what noise and a codec leave."""

    #: [cycles] length of a window
    cycles: float = 2.0
    #: [samples] shortest window
    least_rows: int = 16
    #: [1] number of strongest modes on whose waves the residual is projected
    modes: int = 2
    #: [sd] errors of a codec that are no change of the motion
    #: convention: What it leaves out of small motions.
    omitted_sd: float = 2.0
    #: [1] power of the projection over that of the rest, for each degree of freedom, that noise may reach
    noise: float = 6.0


TUNING = Tuning()


@dataclass(frozen=True)
class Misfit:
    """Unexplained motion of a fit.

    Attributes
    ----------
    share : float
        Power at the frequencies of the strongest modes that the fit leaves beyond noise, as a share of the power of the
        motion.
    start_s, end_s : float
        Window with the largest unexplained power, in the time of the fit's data.
    """

    share: float
    start_s: float
    end_s: float


def misfit(model: ModalFit, omissions: Omissions | None = None) -> Misfit:
    """Unexplained motion of a fit: where its poles fit but amplitudes or phases do not.

    `omissions` of a codec may explain it.

    Bursts of noise raise the power at all frequencies, and are none. Where a mode stands for an unresolved pair, the
    pair explains what one mode does not.
    """
    found = _misfit(model, model.fit.linear, omissions)
    if not model.unresolved:
        return found
    poles = list(model.fit.poles)
    for pair in model.unresolved:
        del poles[int(np.argmin(np.abs(np.array(poles) - pair[0])))]
        poles += list(pair)
    columns = ModeColumns(model.data.time_s, np.array(poles))
    both = _misfit(model, solve_linear(model.problem, columns), omissions)
    return min(found, both, key=lambda one: one.share)


def _misfit(model: ModalFit, linear: LinearSolution, omissions: Omissions | None) -> Misfit:
    data, strongest_hz = model.data, _strongest_hz(model)
    length = max(TUNING.least_rows, int(np.ceil(TUNING.cycles / (strongest_hz[0] * data.step_s))))
    count = data.time_s.size // length
    if count < 2:
        return Misfit(0.0, 0.0, 0.0)
    time_s = data.time_s[: count * length].reshape(count, length)
    # Coloured noise has more power at the modes than white noise.
    coloured = max(1.0, *(model.spectrum.level_aside(hz) for hz in strongest_hz.tolist()))
    excess, moved = np.zeros(count), np.zeros(count)
    for block in row_blocks(count, max(1, AT_ONCE // length)):
        rows = slice(block.start * length, block.stop * length)
        waves = np.exp(2j * np.pi * time_s[block, :, None] * strongest_hz)
        baseline = linear.splines[rows] @ linear.slow
        columns = np.concatenate([np.ones((*waves.shape[:2], 1)), waves.real, waves.imag], axis=2)
        omitted = _power(omissions, rows, length, linear.noise_variance.size)
        for channel, variance in enumerate(linear.noise_variance):
            w, r, y = (
                values[:, channel].reshape(-1, length)
                for values in (data.weights[rows], linear.residual[rows], data.values[rows] - baseline)
            )
            inside, total = _projected(columns, w, r)
            freedom = np.maximum(np.count_nonzero(w, axis=1) - columns.shape[2], 1)
            noise = (total - inside) / freedom
            own = np.maximum(
                inside - TUNING.noise * coloured * (columns.shape[2] - 1) * noise - omitted[:, channel], 0.0
            )
            excess[block] += np.where(freedom > 1, own, 0.0) / variance
            moved[block] += np.maximum(np.sum(w * y**2, axis=1) - length * noise, 0.0) / variance
    worst = int(np.argmax(excess))
    share = float(np.sum(excess)) / max(float(np.sum(moved)), 1e-300)
    return Misfit(share, float(time_s[worst, 0]), float(time_s[worst, -1]))


def _power(omissions: Omissions | None, rows: slice, length: int, channels: int) -> FloatArray:
    """Power in each window, shape (windows, k), that a codec may have left out."""
    count = (rows.stop - rows.start) // length
    if omissions is None:
        return np.zeros((count, channels))
    squares = 0.5 * (TUNING.omitted_sd * omissions.sd(rows)) ** 2
    return np.asarray(np.sum(squares.reshape(count, length, channels), axis=1))


def _strongest_hz(model: ModalFit) -> FloatArray:
    """Frequencies of the modes with most energy, strongest first."""
    return np.asarray(frequency_hz(model.fit.poles)[np.argsort(-model.energy, kind="stable")[: TUNING.modes]])


def _projected(columns: FloatArray, weights: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Power of the projection of each window on the waves, offset removed, and of the window less its offset."""
    weighted = columns * weights[..., None]
    gram = np.swapaxes(weighted, 1, 2) @ columns
    ridge = 1e-6 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-300
    moment = np.einsum("clp,cl->cp", weighted, values)
    solved = np.linalg.solve(gram + ridge * np.eye(columns.shape[2]), moment[..., None])[..., 0]
    offset = moment[:, 0] ** 2 / np.maximum(gram[:, 0, 0], 1e-300)
    total = np.sum(weights * values**2, axis=1)
    return np.maximum(np.sum(moment * solved, axis=1) - offset, 0.0), np.maximum(total - offset, 0.0)

"""What a marker sees while steady shaking stops: piecewise models of a recording, for `modal_id.onset.piecewise`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modal_id.fit.linear import real_columns
from modal_id.onset.piecewise import Shape
from tracker.arrays import ComplexArray, FloatArray

_FREQUENCY_DOUBT = 0.03


def unpacked_poles(nonlinear: FloatArray) -> ComplexArray:
    """Poles from pairs of real and imaginary part."""
    return np.asarray(nonlinear[0::2] + 1j * nonlinear[1::2])


def joined_shape(time_s: FloatArray, *, trend: bool) -> Callable[[FloatArray], Shape]:
    """Sinusoid, then decays: amplitudes and phases free, displacement continuous."""

    def shape(nonlinear: FloatArray) -> Shape:
        stop, drive, poles = float(nonlinear[0]), float(nonlinear[1]), unpacked_poles(nonlinear[2:])
        since = time_s - stop
        after = since >= 0.0
        free = np.where(after[:, None], _decays(np.maximum(since, 0.0), poles), 0.0)
        columns = real_columns(free)
        # The shaken mode's part in phase is what continuity leaves no choice of.
        tied = columns[:, 0].copy()
        columns[:, 2::2] -= tied[:, None]
        age = np.minimum(time_s, stop) - time_s[0]
        on = real_columns(_decays(age, poles[:1]))
        on[after] *= tied[after][:, None]
        driven = np.where(after, tied, np.cos(drive * since))
        quadrature = np.where(after, 0.0, np.sin(drive * since))
        moved = np.where(after, 1.0 - tied, 0.0)
        slow = _slow(since, trend=trend)
        return Shape(
            np.column_stack([slow, driven, quadrature, on, columns[:, 1:], moved]), np.zeros(since.size)
        )

    return shape


def stopped_shape(
    time_s: FloatArray, weak: ComplexArray, *, kick: bool, trend: bool, unseen: bool
) -> Callable[[FloatArray], Shape]:
    """The mechanics that `modal_id.onset.stop` explains; nonlinear: instant, drive, Re B, Im B, poles.

    Without `kick` a force on the structure ends instead: the base is at rest all along and no velocity jumps; B stands
    for the force. With `unseen`, each channel has a part that moves with the base before the stop: modes far from the
    drive that are too weak to be seen follow it in phase or against it.
    """

    def shape(nonlinear: FloatArray) -> Shape:
        stop, drive = float(nonlinear[0]), float(nonlinear[1])
        poles = np.concatenate([unpacked_poles(nonlinear[4:]), weak])
        amplitude = complex(nonlinear[2], nonlinear[3])
        since = time_s - stop
        after = since >= 0.0
        wave = np.exp(1j * drive * np.minimum(since, 0.0))
        base = np.real(amplitude * wave)
        velocity = (1j * drive * amplitude).real if kick else 0.0
        own = np.abs(poles) ** 2
        steady = amplitude * drive**2 / (own - drive**2 - 2j * poles.real * drive)
        place, speed = steady.real, (1j * drive * steady).real + velocity
        ringing = place - 1j * (speed - poles.real * place) / poles.imag
        late = np.maximum(since, 0.0)
        free = np.real(_decays(late, poles) * ringing)
        # The phase of a mode whose frequency only theory tells is soon unknown: its mean over that doubt fades.
        doubt = _FREQUENCY_DOUBT * np.abs(weak) * late[:, None]
        free[:, poles.size - weak.size :] *= np.exp(-0.5 * np.minimum(doubt, 30.0) ** 2)
        columns = [_slow(since, trend=trend), np.where(after[:, None], free, np.real(wave[:, None] * steady))]
        if unseen:
            columns.append(np.where(after, 0.0, base)[:, None])
        return Shape(np.column_stack(columns), base)

    return shape


def _decays(time_s: FloatArray, poles: ComplexArray) -> ComplexArray:
    """``exp(lambda t)``; a pole on the way to nowhere grows without overflow, so that its misfit turns it back."""
    growth = np.minimum(time_s[:, None] * poles.real, 50.0)
    return np.asarray(np.exp(growth + 1j * time_s[:, None] * poles.imag))


def _slow(since: FloatArray, *, trend: bool) -> FloatArray:
    columns = [np.ones(since.size), since / max(float(np.ptp(since)), 1e-300)]
    return np.column_stack(columns[: 1 + trend])

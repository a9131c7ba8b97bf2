"""Recordings of targets that move far between frames: look-alike dots, and a textured ball in front of a wall."""

import cv2
import numpy as np

FPS_DOTS, FPS_BALL = 22.67, 60.0
DOTS_X_PX, DOT_RADIUS_PX = 90.0 + 130.0 * np.arange(5), 11.0
BALL_RADIUS_PX, BALL_HZ, BALL_ZETA = 33.0, 0.9758, 8e-4


def swing_px(frames, amplitude_px=60.0, frames_per_cycle=3.1, at_rest=8, decay=0.05):
    """Displacement of the dots: held at the amplitude, then released into a decay of few frames a cycle."""
    n = np.maximum(np.arange(frames) - at_rest, 0)
    return amplitude_px * np.exp(-decay * n) * np.cos(2 * np.pi * n / frames_per_cycle)


def dot_images(centres_px, *, shape=(110, 700), radius_px=DOT_RADIUS_PX, noise=2.0, seed=0):
    """Dark dots on a light background; centres of shape (frames, dots, 2), NaN for a dot that is hidden."""
    rng = np.random.default_rng(seed)
    rows, columns = np.indices(shape, sparse=True)
    images = []
    for centres in centres_px:
        image = np.full(shape, 200.0)
        for x, y in centres[np.isfinite(centres[:, 0])]:
            image -= np.clip(radius_px - np.hypot(columns - x, rows - y), 0, 1) * 160
        images.append((image + noise * rng.standard_normal(shape)).clip(0, 255).astype(np.uint8))
    return images


def ball_x_px(frames):
    """Centre of the ball, in a height of 120 px: a slow pendulum of 150 px."""
    t = np.arange(frames) / FPS_BALL
    return 320 + 150 * np.exp(-BALL_ZETA * 2 * np.pi * BALL_HZ * t) * np.cos(2 * np.pi * BALL_HZ * t)


def ball_images(frames, seed=0, rows=(0, 240), columns=(0, 640)):
    """A textured ball that swings in front of a textured wall; only these rows and columns are drawn."""
    rng = np.random.default_rng(seed)
    wall = cv2.GaussianBlur(rng.standard_normal((240, 640)).astype(np.float32), (0, 0), 2) * 60 + 120
    skin = cv2.GaussianBlur(rng.standard_normal((81, 81)).astype(np.float32), (0, 0), 3) * 120 + 80
    disc = np.clip(BALL_RADIUS_PX + 0.5 - np.hypot(*(np.indices((81, 81)) - 40.0)), 0, 1).astype(np.float32)
    images, wall = [], wall[slice(*rows), slice(*columns)]
    for x in ball_x_px(frames):
        move = np.float32([[1, 0, x - 40 - columns[0]], [0, 1, 80 - rows[0]]])
        ball, cover = (cv2.warpAffine(part, move, wall.shape[::-1]) for part in (skin, disc))
        image = wall * (1 - cover) + ball * cover + 2 * rng.standard_normal(wall.shape)
        images.append(image.clip(0, 255).astype(np.uint8))
    return images

"""Rendered bare strips, compared with direct integrals over the strip and with its true centreline."""

from math import erf

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline
from support.render_truth import box_gauss, still

from sim.render import (
    BareStrip,
    BendingLine,
    Camera,
    DecayingMode,
    DotMarker,
    Scene,
    Strip,
    Stripe,
    Surface,
    Texture,
    cantilever_slope,
    decaying_cantilever,
    render_frames,
    render_ideal,
    true_centres_px,
    true_line_px,
)

# As of markers: 0.001 counts of 8 bit, half from the cells (2.4e-6 of the contrast an edge), half from the exposure.
GRAY_TOLERANCE = 1.0e-3
# A pattern besides: cubic interpolation at an eighth of its grain, 2e-5 of its gray levels, of up to 100 counts.
PATTERN_TOLERANCE = 2 * GRAY_TOLERANCE
NO_MARKERS = still([], [], [])


def camera(**changes):
    settings = {
        "width_px": 70,
        "height_px": 90,
        "mm_per_px": 0.8,
        "origin_px": (20.3, 9.7),
        "background": 200.0,
    }
    return Camera(**(settings | changes))


def line(angle, length_mm=60.0, points=61):
    return BendingLine(arc_mm=np.linspace(0.0, length_mm, points), angle=angle)


def arc(radius_mm, start_rad=-1.9):
    """A circular arc at rest."""
    return line(lambda time, s: np.tile(start_rad + s / radius_mm, (time.size, 1)))


def bare(motion, width_mm=3.3, **surface):
    return BareStrip(
        width_mm=width_mm, arc_mm=motion.arc_mm, motion=motion, surface=Surface(**{"gray": 50.0, **surface})
    )


def scene(strip, **more):
    return Scene(markers=(), motion=NO_MARKERS, strip=strip, **more)


def ideal(what, cam, time_s=0.0):
    return next(render_ideal(what, cam, np.array([time_s])))


def _arc(s, t, radius_mm, start_rad):
    angle = start_rad + s / radius_mm
    x = radius_mm * (np.sin(angle) - np.sin(start_rad)) - t * np.sin(angle)
    y = -radius_mm * (np.cos(angle) - np.cos(start_rad)) + t * np.cos(angle)
    return x, y


def integral(column, row, cam, radius_mm, start_rad, width_mm, counts):
    """Pixel of an arc of circle: sum of (box * Gaussian) at points of the annulus, by Gauss-Legendre, in px."""
    nodes, weights = np.polynomial.legendre.leggauss(500)
    s, ds = 30.0 * (nodes + 1.0), 30.0 * weights
    near = np.hypot(
        *(a - b for a, b in zip(cam.to_px(*_arc(s, 0.0, radius_mm, start_rad)), (column, row), strict=True))
    )
    s, ds = s[near < 22.0], ds[near < 22.0]
    nodes, weights = np.polynomial.legendre.leggauss(32)
    t, dt = 0.5 * width_mm * nodes[:, None], 0.5 * width_mm * weights[:, None]
    x, y = _arc(s, t, radius_mm, start_rad)
    x_px, y_px = cam.to_px(x, y)
    area = ds * dt * (1.0 - t / radius_mm) / cam.mm_per_px**2
    seen = box_gauss(x_px - column, cam.lens_blur_px) * box_gauss(y_px - row, cam.lens_blur_px)
    return float(np.sum(area * seen * counts(s, t, x, y)))


def worst(image, cam, radius_mm, counts, behind, count=10):
    """Largest difference from the integral, at random pixels of the strip."""
    rows, columns = np.nonzero(np.abs(image - behind) > 1.0)
    assert rows.size > 200
    chosen = np.random.default_rng(1).choice(rows.size, count, replace=False)
    return max(
        abs(image[r, c] - behind[r, c] - integral(c, r, cam, radius_mm, -1.9, 3.3, counts))
        for r, c in zip(rows[chosen], columns[chosen], strict=True)
    )


@pytest.mark.parametrize(("sigma", "radius_mm"), [(0.3, 35.0), (0.6, -80.0), (1.3, 35.0)])
def test_curved_strip_agrees_with_an_integral_over_it(sigma, radius_mm):
    cam = camera(lens_blur_px=sigma)
    image = ideal(scene(bare(arc(radius_mm))), cam)
    error = worst(image, cam, radius_mm, lambda s, t, x, y: -150.0, np.full_like(image, 200.0))
    assert error < GRAY_TOLERANCE, f"{error} counts; the quadrature is within 4e-6 of the contrast"


def test_stripe_texture_and_backdrop_agree_with_the_same_integral():
    cam = camera()
    on_it, behind_it = Texture(sd=10.0, grain_mm=2.0, seed=3), Texture(sd=20.0, grain_mm=3.0, seed=4)
    stripe = Stripe(gray=80.0, width_mm=0.4, offset_mm=-0.7)
    what = scene(bare(arc(35.0), stripe=stripe, texture=on_it), backdrop=behind_it)
    alone = ideal(Scene(markers=(), motion=NO_MARKERS, backdrop=behind_it), cam)

    # cubic splines at a twentieth of the grain: 20 times more exact than the renderer's interpolation
    axes = np.arange(-35.0, 60.0, 0.15), np.arange(-75.0, 20.0, 0.15)
    fine = RectBivariateSpline(axes[1], axes[0], behind_it.on_grid(*axes))

    def counts(s, t, x, y):
        surface = 50.0 + 80.0 * np.exp(-0.5 * ((t + 0.7) / 0.4) ** 2) + on_it.on_grid(s, t[:, 0])
        return surface - 200.0 - fine(y, x, grid=False)

    error = worst(ideal(what, cam), cam, 35.0, counts, alone, count=3)
    assert error < PATTERN_TOLERANCE, (
        f"{error} counts; patterns are interpolated to 2e-5 of their gray levels"
    )


def test_centroid_of_each_row_is_the_true_centreline():
    cam = camera(width_px=330, height_px=470, origin_px=(30.0, 5.0), mm_per_px=1.0, exposure_s=1e-3)
    mode = DecayingMode(number=1, amplitude_mm=25.0, frequency_hz=3.0, damping_ratio=0.01)
    motion = decaying_cantilever(500.0, (mode,), direction_rad=-np.pi / 3)
    # symmetric about the centreline, so that only its curvature of 4e-4 per px can displace the centroid
    strip = bare(motion, width_mm=4.0, stripe=Stripe(gray=40.0, width_mm=0.7))
    what = scene(strip)
    time_s = np.array([0.11, 0.31])
    truth = true_line_px(what, cam, time_s, np.linspace(0.0, 500.0, 501))
    for image, points in zip(render_ideal(what, cam, time_s), truth, strict=True):
        rows = np.arange(25, 415)
        weight = 200.0 - image[rows]
        found = weight @ np.arange(cam.width_px) / weight.sum(axis=1)
        true = np.interp(rows, points[:, 1], points[:, 0])
        # of curvature k at 30 degrees: about 2 k (w^2 / 12 + sigma^2 + 1/12) = 1e-3 px
        assert np.max(np.abs(found - true)) < 1.0e-3, np.max(np.abs(found - true))


def test_exposure_is_the_mean_over_many_instants_of_a_strip():
    turning = line(lambda time, s: -1.3 + 12.0 * time[:, None] * np.ones_like(s))
    what, count, exposure = scene(bare(turning)), 300, 4e-3
    blurred = ideal(what, camera(exposure_s=exposure))
    instants = (np.arange(count) + 0.5) / count * exposure - exposure / 2
    mean = sum(render_ideal(what, camera(), instants)) / count
    # the tip moves 3.6 px: the midpoint rule errs by d^2 / (24 n^2) of the image's curvature, far below
    assert np.max(np.abs(blurred - mean)) < GRAY_TOLERANCE


def test_bare_strip_is_the_plain_strip_behind_a_card():
    dot = DotMarker(diameter_mm=6.0, foreground=30.0, background=200.0, quiet_zone_mm=2.0)
    motion = line(lambda time, s: np.full((time.size, s.size), -1.2))
    ends = motion(np.zeros(1))
    plain = Strip(
        width_mm=1.5, gray=50.0, motion=still(ends.x_mm[0, [0, -1]], ends.y_mm[0, [0, -1]], [0.0, 0.0])
    )
    card = still(ends.x_mm[0, [20, 45]], ends.y_mm[0, [20, 45]], [0.1, 0.2])
    images = [
        ideal(Scene(markers=(dot, dot), motion=card, strip=strip), camera())
        for strip in (plain, bare(motion, width_mm=1.5))
    ]
    assert np.max(np.abs(images[0] - images[1])) < GRAY_TOLERANCE
    assert true_centres_px(Scene(markers=(dot, dot), motion=card), camera(), np.zeros(1)).shape == (1, 2, 2)


def test_strip_at_the_border_is_part_of_the_larger_picture():
    large = camera(width_px=170, height_px=190, origin_px=(70.3, 59.7))
    texture = Texture(sd=9.0, grain_mm=4.0)
    what = scene(bare(arc(35.0)), backdrop=texture)
    full = ideal(what, large)
    assert np.max(np.abs(ideal(what, camera()) - full[50:140, 50:120])) < PATTERN_TOLERANCE
    outside = scene(bare(BendingLine(arc_mm=np.arange(5.0), angle=arc(9.0).angle, origin_mm=(999.0, 0.0))))
    assert np.all(ideal(outside, camera()) == 200.0)


def test_points_keep_their_distance_along_the_line_at_large_rotation():
    radius, length = 150.0, 400.0
    motion = line(lambda time, s: np.tile(0.3 + s / radius, (time.size, 1)), length, points=81)
    cam, at = camera(), np.linspace(0.0, length, 37)
    found = true_line_px(scene(bare(motion)), cam, np.zeros(2), at)
    angle = 0.3 + at / radius
    truth = cam.to_px(radius * (np.sin(angle) - np.sin(0.3)), -radius * (np.cos(angle) - np.cos(0.3)))
    # cubic spline: (h / R)^4 / 384 R = 8e-6 px, up to 40 times more at its ends (not-a-knot)
    assert np.max(np.abs(found[1] - np.column_stack(truth))) < 3.0e-4


def test_slope_of_the_cantilever_belongs_to_its_mode():
    s = np.linspace(0.0, 1.0, 2001)
    for number, nodes in ((1, 0), (3, 2), (5, 4)):
        shape = np.concatenate(
            [
                [0.0],
                np.cumsum(
                    0.5 * np.diff(s) * (cantilever_slope(number, s)[1:] + cantilever_slope(number, s)[:-1])
                ),
            ]
        )
        assert shape[-1] == pytest.approx(1.0, abs=1e-4)
        assert np.sum(np.diff(np.sign(shape[10:])) != 0) == nodes
        assert abs(np.gradient(cantilever_slope(number, s), s)[-1]) < 0.1, "no moment at the tip"


def test_texture_has_its_sd_and_grain_and_is_blurred_in_closed_form():
    texture = Texture(sd=7.0, grain_mm=3.0, seed=5)
    step = 0.5
    x = step * np.arange(800)
    values = texture.on_grid(x, x)
    # 400 x 400 mm hold about 400^2 / (4 pi 3^2) = 1400 independent values, whose squares scatter by sqrt(2 / 1400)
    assert abs(values.var() / 49.0 - 1.0) < 4.0 * np.sqrt(2.0 / 1400.0)
    lag = round(3.0 / step)
    for one, other in ((values[lag:], values[:-lag]), (values[:, lag:], values[:, :-lag])):
        assert np.mean(one * other) / 49.0 == pytest.approx(np.exp(-0.5), abs=4.0 / np.sqrt(1400.0))
    blurred = texture.on_grid(x, x, blur_mm=2.0)
    kernel = np.array(
        [erf((k + 0.5) * step / np.sqrt(8.0)) - erf((k - 0.5) * step / np.sqrt(8.0)) for k in range(-24, 25)]
    )
    rows = np.apply_along_axis(np.convolve, 0, values[:200, :200], 0.5 * kernel, "valid")
    both = np.apply_along_axis(np.convolve, 1, rows, 0.5 * kernel, "valid")
    # the kernel's cells of 0.5 mm blur by their sd of 0.144 mm more: (0.144 / 3)^2 / 2 of each wave of the mean length
    assert np.max(np.abs(both - blurred[24:176, 24:176])) < 3.0 * 7.0 * (0.144 / 3.0) ** 2


def test_noisy_frames_of_a_strip_are_the_same_for_any_duration():
    cam = camera(read_noise_sd=1.0, exposure_s=1e-3)
    what = scene(
        bare(line(lambda time, s: -1.3 + 3.0 * time[:, None] * np.ones_like(s))),
        backdrop=Texture(sd=5.0, grain_mm=3.0),
    )
    times = np.arange(6) / 100.0
    long = list(render_frames(what, cam, times, np.random.default_rng(9)))
    short = list(render_frames(what, cam, times[:3], np.random.default_rng(9)))
    assert all(np.array_equal(a, b) for a, b in zip(short, long[:3], strict=True))


def test_invalid_strips_are_refused():
    straight = arc(1e9)
    with pytest.raises(ValueError, match="width_mm of a strip must be"):
        bare(straight, width_mm=0.0)
    with pytest.raises(ValueError, match="four increasing values"):
        BareStrip(width_mm=1.0, arc_mm=np.array([0.0, 1.0, 1.0, 2.0]), motion=straight)
    with pytest.raises(ValueError, match="61 points"):
        ideal(scene(BareStrip(width_mm=1.0, arc_mm=np.arange(5.0), motion=straight)), camera())
    with pytest.raises(ValueError, match="bent to a radius below its width"):
        ideal(scene(bare(arc(3.0))), camera())
    with pytest.raises(ValueError, match="lie at 0 to 60 mm"):
        true_line_px(scene(bare(straight)), camera(), np.zeros(1), np.array([61.0]))
    with pytest.raises(ValueError, match="no bare strip"):
        true_line_px(Scene(markers=(), motion=NO_MARKERS), camera(), np.zeros(1), np.zeros(1))
    with pytest.raises(ValueError, match="without markers only"):
        Scene(
            markers=(DotMarker(diameter_mm=6.0),), motion=NO_MARKERS, backdrop=Texture(sd=1.0, grain_mm=1.0)
        )
    for wrong in ({"sd": -1.0, "grain_mm": 1.0}, {"sd": 1.0, "grain_mm": 0.0}):
        with pytest.raises(ValueError, match="of a texture must be finite"):
            Texture(**wrong)
    with pytest.raises(ValueError, match="width_mm of a stripe"):
        Stripe(gray=1.0, width_mm=0.0)

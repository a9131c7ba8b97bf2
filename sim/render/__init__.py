"""Synthetic recordings: prints moved by any motion, filmed by a modelled camera, with the true centres kept.

The renderer knows nothing of beams: it takes motions. Its parts, each in a module of its own:

`sim.render.camera.Camera(*, width_px, height_px, mm_per_px, origin_px, exposure_s=0.0, lens_blur_px=0.6,
read_noise_sd=0.0, noise_gain=0.0, bit_depth=8, background=200.0, flicker_sd=0.0)`
    `origin_px` = (x, y) of the world's origin (the clamp). `to_px(x_mm, y_mm)` gives pixels.
`sim.render.markers.DotPrint(*, diameter_mm, ink=30.0, card=None, quiet_zone_mm=0.0)`,
`sim.render.markers.ArucoPrint(*, dictionary, marker_id, size_mm, quiet_zone_mm=2.0, ink=30.0, card=200.0)`
    Gray levels are in counts of the camera. `card=None` prints a dot straight onto the background.
`sim.render.motion.Poses(x_mm, y_mm, angle_rad)`, arrays (k, m);
`sim.render.motion.SampledMotion(time_s, x_mm, y_mm, angle_rad)`: cubic interpolation of dense samples (n, m)
    A motion is any callable from times (k,) in s to `Poses`. SampledMotion refuses times outside its samples.
`sim.render.scene.Strip(*, width_mm, gray, motion)`: the beam itself, a polyline through moving points
`sim.render.scene.Scene(*, prints, motion, strip=None)`: print i follows column i of the motion
`sim.render.frames.render_frames(scene, camera, frame_times_s, rng) -> Iterator[NDArray]`
    uint8 (8 bit) or uint16 (more), shape (height_px, width_px).
`sim.render.frames.render_ideal(scene, camera, frame_times_s) -> Iterator[NDArray[float64]]`
    the same without noise, flicker, rounding and clipping.
`sim.render.frames.true_centres_px(scene, camera, frame_times_s) -> NDArray[float64]`, (n, m, 2): x, y
`sim.render.video.write_video(path, frames, *, fps_container, codec="mjpeg", quality=2, crf=18) -> int`
    codec "mjpeg" (quality scale 2..31, even sides), "ffv1" (lossless, 8 to 16 bit) or "libx264" (crf, even sides).
    Returns the number of frames. The same frames give the same bytes.

Conventions: world in mm, x right, y up, origin at the clamp; image in px, x right, y down, pixel centres at
integers. `angle_rad` is counter-clockwise as seen; at 0 a print stands upright. `frame_times_s` are the middles
of the exposures, and the true centres are the centres at those times.
"""

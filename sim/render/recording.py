"""A simulated recording and the video file that holds it, with reproducible bytes.

The clamp is driven at a mode and stopped, the beam decays, and a camera cropped to the motion films it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any, Literal, get_args

import av
import numpy as np
from numpy.typing import NDArray

from sim.beam import AncfBeam, BeamProperties, beam_modes
from sim.damping import DampingModel
from sim.dynamics import FailedSimulation, Trajectory, longest_step_s, shake_and_stop
from sim.render.camera import Camera, SampledMotion
from sim.render.frames import Scene, Strip, render_frames, true_centres_px, true_line_px
from sim.render.markers import Marker, Texture
from sim.render.strip import BareStrip, Surface
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """The simulation behind a film, and its frame."""

    #: [steps] time steps per period of the mode
    #: physics: The spline between them is exact to (2 pi / 24)^4 / 384 = 1e-5 of the amplitude.
    steps_per_cycle: int = 24
    #: [s] the exposure limits the step only above this
    #: convention: Chosen: shorter exposures are instants to the motion.
    shortest_step_s: float = 1e-4
    #: [1] points of the centreline
    #: physics: 6 mm apart on 500 mm: a spline through mode 5 is off by (14.1 x 6 / 500)^4 / 384 = 2e-6 of it.
    strip_points: int = 81
    #: [px] margin of the frame around everything that moves
    #: convention: The reach of the blur, 5.5 x 0.6 px, and room for a tracker's window; chosen.
    margin_px: int = 8
    #: [px] frame sides are multiples of it
    #: physics: The block of the codecs: nothing is padded.
    block_px: int = 16
    #: [periods] the clamp comes to rest within this share of a period
    #: convention: Short against a period, so that the decay begins with the driven shape; chosen.
    stop_cycles: float = 0.1
    #: [s] but not faster
    #: physics: No shaker is faster.
    shortest_stop_s: float = 1e-3


TUNING = Tuning()


@dataclass(frozen=True, kw_only=True)
class RecordingPlan:
    """Steady excitation at a mode's frequency for `shake_s`, then free decay for `decay_s`."""

    mode_number: int
    tip_amplitude_m: float
    shake_s: float
    decay_s: float


@dataclass(frozen=True, kw_only=True)
class Optics:
    """The camera without its frame, which is cropped to the beam."""

    fps: Fraction
    mm_per_px: float
    exposure_s: float
    lens_blur_px: float = 0.6
    read_noise_sd: float = 1.0
    noise_gain: float = 0.02
    background: float = 200.0
    bit_depth: int = 8


@dataclass(frozen=True)
class StagedRecording:
    """A simulated recording before it is rendered: the scene, the camera, and the times of its exposures.

    Attributes
    ----------
    scene : Scene
    camera : Camera
    frame_times_s : array, shape (n,)
        Middle of each exposure in the simulation's time; the first is time 0 of the recording.
    onset_s : float
        Beginning of the stop, from the first frame.
    """

    scene: Scene
    camera: Camera
    frame_times_s: FloatArray
    onset_s: float

    @property
    def centres_px(self) -> FloatArray:
        """True x and y of each marker, shape (n, m, 2)."""
        return true_centres_px(self.scene, self.camera, self.frame_times_s)

    def line_px(self, positions_m: FloatArray) -> FloatArray:
        """True x and y of the centreline at distances from the clamp, shape (n, k, 2); ValueError if not bare."""
        return true_line_px(self.scene, self.camera, self.frame_times_s, 1e3 * positions_m)

    def frames(self, rng: np.random.Generator) -> Iterator[NDArray[Any]]:
        """Frames with the camera's noise from `rng`, each rendered when it is taken."""
        return render_frames(self.scene, self.camera, self.frame_times_s, rng)


def stage_recording(
    properties: BeamProperties,
    damping: DampingModel,
    plan: RecordingPlan,
    optics: Optics,
    *,
    markers: tuple[Marker, ...] = (),
    positions_m: FloatArray | None = None,
    surface: Surface | None = None,
    backdrop: Texture | None = None,
    mode_count: int = 8,
) -> StagedRecording | FailedSimulation:
    """Simulate a recording and crop the camera to it.

    Parameters
    ----------
    properties, damping, plan, optics :
    markers : tuple of Marker
    positions_m : array, shape (m,)
        Distances of the markers from the clamp along the beam.
    surface : Surface or None
        Of the beam itself as it is to be tracked, with its true thickness; None draws it plain behind the markers.
    backdrop : Texture or None
        Pattern of the background, behind a beam with a `surface` and without markers.
    mode_count : int
        Modes in the steady state; more than the damping model has.

    Raises
    ------
    ValueError
        If the mode is not among the modes of the mesh, or would have no steady state; or if there is neither a marker
        nor a surface.
    """
    if not markers and surface is None:
        msg = "a recording needs markers, or a surface of the beam itself; give one of them"
        raise ValueError(msg)
    positions_m = np.zeros(0) if positions_m is None else positions_m
    beam = AncfBeam(properties)
    modes = beam_modes(beam, mode_count)
    period_s = 1.0 / float(modes.frequency_hz[plan.mode_number - 1])
    step_s, every = _steps(optics, period_s)
    strip_m = np.linspace(0.0, properties.length_m, TUNING.strip_points)
    lead_s = math.ceil(optics.exposure_s / step_s + 1) * step_s
    motion = shake_and_stop(
        beam,
        damping,
        modes,
        mode_number=plan.mode_number,
        tip_amplitude_m=plan.tip_amplitude_m,
        shake_s=plan.shake_s + lead_s,
        decay_s=plan.decay_s + lead_s,
        step_s=step_s,
        stop_s=max(TUNING.stop_cycles * period_s, TUNING.shortest_stop_s),
        output_positions_m=np.concatenate([positions_m, strip_m]),
    )
    if not isinstance(motion, Trajectory):
        return motion
    count = math.floor((plan.shake_s + plan.decay_s) * optics.fps) + 1
    times = np.asarray(lead_s + np.arange(count) * (every * step_s), dtype=np.float64)
    thickness_m = float(properties.thickness_m.max())
    camera = _cropped(motion, optics, max((m.half_extent_mm for m in markers), default=1e3 * thickness_m))
    followed = slice(0, positions_m.size)
    line = _sampled(motion, slice(positions_m.size, None))
    strip = (
        Strip(
            width_mm=max(1e3 * thickness_m, 0.8 * optics.mm_per_px), gray=0.4 * optics.background, motion=line
        )
        if surface is None
        else BareStrip(width_mm=1e3 * thickness_m, arc_mm=1e3 * strip_m, motion=line, surface=surface)
    )
    scene = Scene(markers=markers, motion=_sampled(motion, followed), strip=strip, backdrop=backdrop)
    return StagedRecording(scene, camera, times, plan.shake_s)


def _steps(optics: Optics, period_s: float) -> tuple[float, int]:
    """Time step, a whole fraction of the frame interval, and steps per frame."""
    interval_s = float(1 / optics.fps)
    exposed_s = max(optics.exposure_s, TUNING.shortest_step_s)
    longest = min(longest_step_s(0.0), period_s / TUNING.steps_per_cycle, exposed_s)
    every = math.ceil(interval_s / longest)
    return interval_s / every, every


def _sampled(motion: Trajectory, points: slice) -> SampledMotion:
    return SampledMotion(
        motion.time_s, 1e3 * motion.x_m[:, points], 1e3 * motion.y_m[:, points], motion.angle_rad[:, points]
    )


def _cropped(motion: Trajectory, optics: Optics, half_extent_mm: float) -> Camera:
    """Camera whose frame holds all markers at all times with a margin, in whole blocks."""
    reach = math.sqrt(2.0) * half_extent_mm / optics.mm_per_px + TUNING.margin_px
    x, y = 1e3 * motion.x_m / optics.mm_per_px, -1e3 * motion.y_m / optics.mm_per_px
    left, top = float(x.min()) - reach, float(y.min()) - reach
    width = _blocks(float(x.max()) + reach - left)
    height = _blocks(float(y.max()) + reach - top)
    return Camera(
        width_px=width,
        height_px=height,
        mm_per_px=optics.mm_per_px,
        origin_px=(0.5 * (width - float(x.max()) - float(x.min())), -top),
        **{name: value for name, value in vars(optics).items() if name not in ("fps", "mm_per_px")},
    )


def _blocks(length_px: float) -> int:
    return TUNING.block_px * math.ceil(length_px / TUNING.block_px)


Codec = Literal["mjpeg", "ffv1", "libx264"]
# of the containers that hold all of them
SUFFIXES = (".avi", ".mkv", ".mp4", ".mov")

# FFmpeg's FF_QP2LAMBDA: its global quality is the quality scale times this.
_LAMBDA_PER_QSCALE = 118
# chroma planes have half as many rows and columns
_SIDE_MULTIPLE = {"mjpeg": 2, "ffv1": 1, "libx264": 2}


def write_video(
    path: Path,
    frames: Iterable[NDArray[Any]],
    *,
    fps_container: Fraction,
    codec: Codec = "mjpeg",
    quality: int = 2,
    crf: int = 18,
) -> int:
    """Write gray frames to a video file, in one thread and without time or version stamps, so that its bytes repeat.

    Parameters
    ----------
    path : Path
        The suffix selects the container (.avi, .mkv, .mp4). Overwritten if it exists.
    frames : iterable of array, shape (height, width)
        uint8, or uint16 of any depth up to 16 bit with "ffv1" (stored as 16 bit, values unchanged), which is lossless.
        "mjpeg" and "libx264" need even sides.
    fps_container : Fraction
        Playback rate declared in the file; high-speed cameras usually write 25 or 30.
    quality, crf : int
        Quality scale of "mjpeg", 2 (best) to 31, and constant rate factor of "libx264", 0 (best) to 51.

    Returns
    -------
    int
        Number of frames written.

    Raises
    ------
    ValueError
        If there is no frame, a frame differs in shape or type from the first, or codec and frames do not match.
    """
    if codec not in get_args(Codec):
        msg = f"codec must be one of {', '.join(get_args(Codec))}, got {codec!r}"
        raise ValueError(msg)
    iterator = iter(frames)
    first = next(iterator, None)
    if first is None:
        msg = f"{path.name}: no frames to write"
        raise ValueError(msg)
    _check_first(first, codec)
    with av.open(str(path), mode="w", options={"fflags": "+bitexact"}) as container:
        stream = container.add_stream(codec, rate=fps_container, options=_options(codec, quality, crf))
        stream.height, stream.width = first.shape
        stream.pix_fmt = _pixel_format(codec, first)
        stream.codec_context.thread_count = 1
        count = 0
        for image in chain([first], iterator):
            if image.shape != first.shape or image.dtype != first.dtype:
                msg = (
                    f"{path.name}: frame {count} is {image.shape} {image.dtype}, the first was "
                    f"{first.shape} {first.dtype}"
                )
                raise ValueError(msg)
            frame = _to_frame(image, stream.pix_fmt)
            frame.pts = count
            frame.time_base = 1 / fps_container
            container.mux(stream.encode(frame))
            count += 1
        container.mux(stream.encode(None))
    return count


def _check_first(frame: NDArray[Any], codec: Codec) -> None:
    if frame.ndim != 2 or frame.dtype not in (np.uint8, np.uint16):
        msg = f"frames must be gray (height, width) of uint8 or uint16, got {frame.shape} {frame.dtype}"
        raise ValueError(msg)
    if codec != "ffv1" and frame.dtype != np.uint8:
        msg = f"{codec} stores 8 bit only; write 16 bit frames with ffv1"
        raise ValueError(msg)
    multiple = _SIDE_MULTIPLE[codec]
    if frame.shape[0] % multiple or frame.shape[1] % multiple:
        msg = f"{codec} needs sides that are multiples of {multiple}, got {frame.shape[1]} x {frame.shape[0]} px"
        raise ValueError(msg)


def _pixel_format(codec: Codec, frame: NDArray[Any]) -> str:
    if codec == "ffv1":
        return "gray" if frame.dtype == np.uint8 else "gray16le"
    # full range: counts are stored unchanged in the luma plane
    return "yuvj420p"


def _options(codec: Codec, quality: int, crf: int) -> dict[str, str]:
    if codec == "mjpeg":
        return {
            "flags": "+bitexact+qscale",
            "global_quality": str(quality * _LAMBDA_PER_QSCALE),
            "qmin": str(quality),
            "qmax": str(quality),
        }
    if codec == "libx264":
        # x264's macroblock tree reads uninitialised memory for frames narrower than 128 px, and the bytes then vary
        return {"flags": "+bitexact", "crf": str(crf), "x264-params": "mbtree=0"}
    return {"flags": "+bitexact", "level": "3", "slicecrc": "1"}


def _to_frame(image: NDArray[Any], pixel_format: str) -> av.VideoFrame:
    if pixel_format != "yuvj420p":
        return av.VideoFrame.from_ndarray(image, format=pixel_format)
    height, width = image.shape
    planes = np.full((height * 3 // 2, width), 128, dtype=np.uint8)
    planes[:height] = image
    return av.VideoFrame.from_ndarray(planes, format="yuvj420p")

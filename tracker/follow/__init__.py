"""Following the markers from frame to frame: predicted windows, registration, recovery, flags."""

from tracker.follow.follower import Follower
from tracker.follow.frame_results import FrameResult

__all__ = ["Follower", "FrameResult"]

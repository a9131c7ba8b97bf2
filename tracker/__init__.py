"""Frames to marker positions with standard deviations, and to displacement series.

The way of the data, one folder each: ``video`` reads frames, ``geometry`` gives time axis, lens and scale, ``markers``
finds the markers, ``template`` models their image and the noise of the pixels, ``register`` fits the template to one
frame, ``follow`` goes from frame to frame. `tracker.track` joins them; results are in `tracker.results`. The public API
is the package `modalcam`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Kinds of markers: one module each, behind the protocol of `tracker.markers.kind`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""The bare beam seen edge-on: its centreline, surface and image."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

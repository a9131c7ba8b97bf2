"""Footage of the simulated beam, and footage with the tracks drawn in."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

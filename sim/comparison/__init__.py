"""Comparison of recorded decays with simulations under each damping model (Fig. 2 to 4)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

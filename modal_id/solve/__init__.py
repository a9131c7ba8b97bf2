"""Weighted linear least squares of decaying modes on a spline baseline, and the fit of their poles (Eq. 1, 2)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Displacement series to natural frequencies and damping ratios with their posterior.

One folder for each step: ``data`` prepares the samples, ``fit`` fits Eq. 1, ``segments`` finds the free decays in the
record, ``curve`` fits frequency and damping ratio as functions of the amplitude, ``posterior`` samples them, ``modes``
numbers the modes and checks them, ``pieces`` fits the decays and divides those whose motion changes.
`modal_id.identify` calls them; results are in `modal_id.results`. The public API is the package `modalcam`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

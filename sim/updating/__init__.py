"""Updating of the beam's properties from measured modes (Tables 1 and 3), by three methods.

`update_like_paper`: without gravity, every width and thickness, density and modulus free within a bound.
`update_uniform`: with gravity, one change along the whole beam. `update_bayesian`: with gravity, smooth fields and a
sampled posterior. `find_point_mass` looks for a mass that the beam lacks; `compare_models` selects between kinds of
beam; `update` does all of them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""A thin beam in the absolute nodal coordinate formulation: modes, decays, updating, comparison, synthetic footage.

One folder each: ``beam`` has properties, elements, equilibrium and modes; ``damping`` the damping models; ``dynamics``
the motion in time; ``updating`` matches the beam to measured modes; ``comparison`` compares measured with simulated
decays; ``render`` films the simulated beam; ``reference`` has the paper's beam and tables. The public API is the
package `modalcam`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

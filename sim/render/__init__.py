"""Synthetic recordings: markers or a bare beam in any motion, filmed by a modelled camera, with the true positions.

`camera` models geometry, exposure, lens and noise, `markers` what is printed, `strip` a beam without markers,
`motion` and `scene` what moves, `frames` renders, `video` writes the file. The renderer takes any motion;
`recording` and `simulated_motion` supply those of a simulated beam.

Conventions: world in mm, x right, y up, origin at the clamp; image in px, x right, y down, pixel centres at integers.
Angles are counter-clockwise as seen; at 0 a marker is upright. Frame times are the middles of the exposures, and the
true centres are those at these times.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

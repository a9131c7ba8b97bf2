from .bare_strip import BareStrip as BareStrip
from .bare_strip import Stripe as Stripe
from .bare_strip import Surface as Surface
from .bending import BendingLine as BendingLine
from .bending import DecayingMode as DecayingMode
from .bending import cantilever_slope as cantilever_slope
from .bending import decaying_cantilever as decaying_cantilever
from .strip_image import StripImage as StripImage

"""The line of a thin beam, or a straight edge, as the marker: its normal displacement at stations along it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

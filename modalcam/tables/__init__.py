"""Every file of OUT but the report: what a run found as CSV, JSON, NetCDF and universal files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Displacement series to natural frequencies and damping ratios with their posterior.

The way of the data, one folder each: ``data`` prepares the samples, ``fit`` fits Eq. 1, ``segments`` finds the free
decays in the record, ``posterior`` samples frequency and damping ratio, ``modes`` numbers the modes and checks them.
`modal_id.identify` joins them; results are in `modal_id.results`. The public API is the package `modalcam`.
"""

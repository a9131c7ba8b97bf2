"""Samples that can be fitted: saturation, outliers, baseline."""

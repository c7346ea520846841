"""Elevation models in files: what their pixels, units and reference systems mean."""

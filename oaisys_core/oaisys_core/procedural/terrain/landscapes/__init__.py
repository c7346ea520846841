"""Terrain presets that are made by processes, at any size of the stage."""

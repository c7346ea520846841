"""Brightness of what rays meet, without Blender."""

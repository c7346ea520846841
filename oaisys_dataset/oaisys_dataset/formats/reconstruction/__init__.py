"""Formats of programs that rebuild a surface from images: true cameras and points."""

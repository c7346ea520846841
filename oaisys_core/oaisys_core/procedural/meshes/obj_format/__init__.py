"""Meshes in Wavefront OBJ files, and their materials."""

"""Meshes in glTF files."""

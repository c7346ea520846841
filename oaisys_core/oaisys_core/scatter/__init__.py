"""Rocks made by code, and where they lie."""

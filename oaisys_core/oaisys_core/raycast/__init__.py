"""Exact depth and labels by ray casting, shared by all backends."""

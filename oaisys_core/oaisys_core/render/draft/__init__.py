"""Colour from cast rays, without sampling noise: the quality `draft` of both backends."""

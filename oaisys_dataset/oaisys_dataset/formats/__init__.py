"""Formats in which a data set is exported; a module for each, and what they share in `base`."""

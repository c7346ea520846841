"""Thousands of samples through all processes at once, to see whether anything grows."""

"""Renders thousands of samples with all processes running, to find what grows."""

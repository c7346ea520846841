"""Evaluation of a reconstruction against the true surface."""

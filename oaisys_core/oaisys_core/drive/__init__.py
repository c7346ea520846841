"""Timed drives: when each sensor measures, and what it measures there."""

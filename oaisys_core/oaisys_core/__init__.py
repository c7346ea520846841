"""The simulator's core: what a world is, how it is drawn from a seed, and how it is rendered."""

__version__ = "0.1.0"

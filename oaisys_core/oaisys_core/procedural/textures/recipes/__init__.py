"""Recipes of the built-in texture sets, each a function of a seed."""

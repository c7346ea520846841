"""Signed certificates of reconstructions, and the deliberate faults that they must reject."""

"""Signed certificates of reconstructions, and perturbation tests of their thresholds."""

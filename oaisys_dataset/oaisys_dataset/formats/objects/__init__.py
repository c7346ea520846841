"""Formats for detectors, segmentation and object poses, and what they share."""

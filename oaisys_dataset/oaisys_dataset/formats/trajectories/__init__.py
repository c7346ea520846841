"""Formats of programs that follow a camera: its images in the order of time, with true poses."""

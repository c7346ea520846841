"""Files from outside, opened within bounds: their sizes are known before they are decoded."""

"""Clouds with volume: where they are dense, and the picture of them on the dome of the sky."""

"""The ground around a stage: generated land to the horizon, or a level plain."""

"""Sun, sky images and effects: what the environment module draws from."""

"""From a generator and numbers to arrays: grounds, textures, objects, light."""

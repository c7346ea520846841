"""Texture sets baked from geometry: meshes are cast from above and laid over a tile."""

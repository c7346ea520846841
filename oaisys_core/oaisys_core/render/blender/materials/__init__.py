"""Materials as Blender's shader nodes."""

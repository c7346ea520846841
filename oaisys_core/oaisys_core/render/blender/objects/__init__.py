"""A scene's ground, objects, light and sky as Blender's objects."""

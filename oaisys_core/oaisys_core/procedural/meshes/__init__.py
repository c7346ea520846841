"""Users' meshes: read from files, and checked before they are rendered."""

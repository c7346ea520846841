"""What is checked of files with meshes before they are read."""

"""What bags tell of a run: its poses, transforms and samples."""

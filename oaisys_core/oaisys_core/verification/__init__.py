"""Independent checks of what was rendered: the label-geometry audit, and recorded samples."""

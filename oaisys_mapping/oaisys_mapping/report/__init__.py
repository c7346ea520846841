"""Reports of experiments and the live web viewer."""

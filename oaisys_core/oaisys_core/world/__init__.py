"""The world of a batch: drawing, reusing, saving, restoring and recording it."""

"""The world of a batch: how it is drawn, kept, reused, undone and recorded."""

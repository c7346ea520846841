"""What images show of single objects: their outlines, boxes and poses."""

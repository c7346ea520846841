"""What a data set says of itself: its conventions, machine-readable metadata and a data card."""

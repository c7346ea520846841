"""The look book: one picture of each world and light, with figures that tell how natural it is."""

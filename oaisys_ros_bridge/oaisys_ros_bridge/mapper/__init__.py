"""What the mapper node is made of."""

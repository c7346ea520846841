"""What rays can hit: the interface, and the ground and placements of a scene behind it."""

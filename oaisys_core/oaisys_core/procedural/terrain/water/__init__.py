"""Water on and around a ground, and how wet each place is."""

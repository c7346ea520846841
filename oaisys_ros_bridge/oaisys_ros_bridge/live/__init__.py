"""The live page, from which a person flies or drives the simulator's camera."""

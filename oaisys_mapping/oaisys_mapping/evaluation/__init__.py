"""How true a reconstruction is, measured against the true surface."""

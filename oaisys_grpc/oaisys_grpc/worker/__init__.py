"""The process that runs the simulation, and what it shares with the server."""

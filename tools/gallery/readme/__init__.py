"""The pictures of the README: six worlds, and a survey whose mesh grows."""

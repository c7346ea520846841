"""The gallery: what the simulator can show, rendered, with its labels."""

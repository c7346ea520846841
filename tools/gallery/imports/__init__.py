"""Files as people bring them, made by code, and what the simulator shows of them."""

"""The ground's material as shader nodes, and the albedo that these give a view."""

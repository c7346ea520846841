"""Renders the worlds of a data set: on Ray, each in a worker, and their shards written."""

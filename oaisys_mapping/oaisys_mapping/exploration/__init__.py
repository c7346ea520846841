"""Deciding where to look next: an observed map, planners under one interface, their coverage."""

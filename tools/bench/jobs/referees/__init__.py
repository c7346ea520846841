"""Drives, surveys and flights, and what programs of others make of them."""

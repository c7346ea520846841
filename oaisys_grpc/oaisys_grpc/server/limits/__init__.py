"""Limits that keep one client from holding up the others."""

"""Keeps a worker process running, within its limits of time and memory."""

"""The queue of jobs for the worker, and what they bring."""

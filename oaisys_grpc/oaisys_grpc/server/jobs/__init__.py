"""The queue of jobs for the worker, and the samples that they bring."""

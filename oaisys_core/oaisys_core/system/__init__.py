"""Folders of the operating system, processes and signals, as every program here needs them."""

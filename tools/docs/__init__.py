"""The documentation site: its pages are gathered from the repository, or written from the code."""

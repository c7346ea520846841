"""Reports and live pages for people; ``report.json`` for programs."""

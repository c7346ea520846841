"""The programs: each module is one node."""

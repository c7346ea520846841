"""Things made by code, and where they stand, lie and drive."""

"""Small pictures for the site: one of each name, and two of each key that changes a picture."""

"""What objects look like in drafts."""

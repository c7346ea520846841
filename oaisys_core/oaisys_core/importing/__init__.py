"""Files of other programs turned into configurations: the original simulator's, and robots."""

"""Where the layers of the ground's material lie."""

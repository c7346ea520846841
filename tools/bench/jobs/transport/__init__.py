"""Jobs of the topic ``transport``: samples to a client, and to ROS subscribers."""

"""rosbag2 bags in the MCAP format: written, read, recovered, played."""

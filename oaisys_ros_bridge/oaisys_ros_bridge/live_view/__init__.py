"""The live view in a browser, of a server or of a running ROS system."""

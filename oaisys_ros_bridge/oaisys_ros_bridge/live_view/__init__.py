"""The live view in a browser, of a gRPC server or of ROS topics."""

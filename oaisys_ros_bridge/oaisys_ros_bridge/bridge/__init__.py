"""What the bridge node is made of: its link to the simulator, requests, and their order."""

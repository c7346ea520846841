"""Makes the virtual environment: pinned packages, relocated ROS wheels, built interfaces.

Runs on the base interpreter with nothing but the standard library.
"""

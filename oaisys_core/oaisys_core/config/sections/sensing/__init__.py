"""Configuration of the rig: its sensors, their faults and its motion."""

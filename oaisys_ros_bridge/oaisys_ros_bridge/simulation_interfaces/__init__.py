"""The services and the action of ``simulation_interfaces``."""

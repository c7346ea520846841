"""The server: owns the port, the job queue and the worker; never imports Blender."""

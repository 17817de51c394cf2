"""Sensors' readings on a drone: taken, kept on disk, and carried to the fog."""

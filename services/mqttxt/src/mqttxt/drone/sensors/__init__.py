"""Sensors' readings on a drone: received, stored on disk, and carried to the fog."""

DEFAULT_LIMIT = 100_000
"""Readings that a drone keeps: three per second for nine hours, in about ten megabytes."""

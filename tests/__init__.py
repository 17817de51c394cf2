"""The tests, and their shared helpers."""

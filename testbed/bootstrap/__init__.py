"""Prepares a bare machine: virtual environment, Docker, images. Uses only the standard library."""

"""Gets a bare machine ready: virtual environment, Docker, images. Standard library only."""

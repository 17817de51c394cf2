"""The `mqttxt` command: each role as a subcommand."""

from .main import main

__all__ = ["main"]

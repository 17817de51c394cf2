"""`python -m mqttxt` is the `mqttxt` command."""

from .cli import main

main()

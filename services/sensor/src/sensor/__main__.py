"""`python -m sensor` is the `sensor` command."""

from .cli import main

main()

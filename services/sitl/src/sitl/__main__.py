"""`python -m sitl` is the `sitl` command."""

from .cli import main

main()

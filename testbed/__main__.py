"""`python -m testbed` is the `testbed` command."""

from .cli import main

main()

"""`python -m testbed` is the `testbed` command."""

from .cli.commands import main

main()

"""The `testbed` command: a module for each part."""

"""The activator of a fog: its process, and its role as a state machine without I/O."""

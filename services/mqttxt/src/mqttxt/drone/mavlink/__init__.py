"""MAVLink: the link to an autopilot, what its messages mean as states, and commands as messages."""

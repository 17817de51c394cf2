"""MAVLink: the link to an autopilot, states from its messages, and messages for commands."""

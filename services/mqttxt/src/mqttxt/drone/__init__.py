"""The UAV client: its process, and its role as a state machine without I/O.

A command's way down: `process`, `role`, `commands`, `executor`, `mavlink`.
"""

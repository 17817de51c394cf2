"""Records what an autopilot does in named cases, and compares two recordings.

A `pilot` flies `cases` over a `channel`, which is UDP to a process (`subjects`) or the stand-in in simulated time; the
messages received become a `recording` of facts, and `agreement` finds where two recordings differ.
"""

"""Records what an autopilot does in named cases, and compares two recordings.

`cases` are flown by a `pilot` over a `channel`, which is UDP to a process (`subjects`) or the stand-in in simulated
time; what was heard becomes a `recording` of facts, and `agreement` says where two of them differ.
"""

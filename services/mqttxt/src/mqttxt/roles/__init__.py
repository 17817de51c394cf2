"""The roles as state machines without I/O: messages and times go in, effects come out."""

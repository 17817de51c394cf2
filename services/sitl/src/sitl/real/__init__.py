"""Real autopilots in the stand-in's place: started from the fleet's file, and watched past all links.

`autopilot` is the interface; `px4` and `ardupilot` prepare one of their kind (its folder, parameters, links and command
line); `process` runs it; `witness` reads the autopilot's own messages, on a link of its own; `watching` writes what
they report into the stand-in's files.
"""

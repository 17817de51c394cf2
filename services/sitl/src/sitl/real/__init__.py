"""Real autopilots in the stand-in's place: started with the fleet's file, and watched past all links.

`autopilot` says what one is prepared from; `px4` and `ardupilot` prepare one of their kind (its folder, parameters,
links and command line); `process` runs whatever was prepared; `witness` says what an autopilot's own messages tell, on
a link of its own; `watching` writes that into the stand-in's files.
"""

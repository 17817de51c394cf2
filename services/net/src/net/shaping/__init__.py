"""The links' part of `net route`: chooses a shaper, starts it, and passes on the mission's start and all changes.

run_plan   the file that the host wrote
choice     the choice of the shaper
emulated   the emulator, a separate process
kernel     netem, by commands (kernel_plan, commands), read back (readback) and counted (tallies)
gates      links that are open while a drone is near
server     changes by hand
journal    all changes, with times
attend     all of it together
"""

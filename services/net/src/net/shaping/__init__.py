"""What `net route` does about links: chooses a shaper, starts it, passes on when the mission starts and what changes.

run_plan   the file that the host wrote
choice     which shaper there can be
emulated   the emulator, a process of its own
kernel     netem, by commands (kernel_plan, commands), read back (readback) and counted (tallies)
gates      links that are open while a drone is near
server     changes by hand
journal    everything that changed, and when
attend     all of it together
"""

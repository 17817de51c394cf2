"""The link emulator on NFQUEUE: shapes every directed link where the kernel has no netem, with the same statistics.

plan and network have the links' settings, link (with jitter and turns) applies them to a frame, all without I/O;
nfqueue, rules and injector are the interface to the kernel; shaper is the loop between the two, process the whole.

Differences from netem: a flipped bit is never in the Ethernet header, which NFQUEUE does not show; only forwarded IPv4
is shaped, not ARP; jitter is a function of time, not of the packet (see jitter); losses are drawn from the plan's seed,
packet by packet.
"""

"""The link emulator on NFQUEUE: shapes every directed link where the kernel has no netem, with the same statistics.

plan and network say what is to be done, link (with jitter and turns) does it to a frame, all without I/O; nfqueue,
rules and injector reach the kernel; shaper is the loop between the two, process the whole.

What it does not do as netem does: a turned bit is never in the Ethernet header, which NFQUEUE does not show; ARP is not
shaped, only IPv4 that is forwarded is; jitter belongs to the time and not to the packet (see jitter), and what is lost
is drawn from the plan's seed, packet by packet.
"""

"""The link emulator on NFQUEUE: shapes every directed link where the kernel has no netem, with the same statistics."""

"""From captures to numbers: the table of packets, dissection, metrics, statistics."""

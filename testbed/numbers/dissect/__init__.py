"""scapy layers for what the testbed's nodes say to each other: `mavlink` (1 and 2) and `mqtt5`, with `bind()` in each.

Importing a layer changes nothing in scapy; `bind()` makes it dissect the ports in use, `unbind()` ends that.
"""

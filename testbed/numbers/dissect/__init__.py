"""scapy layers for what the testbed's nodes say to each other: `mavlink` (1 and 2) and `mqtt5`, with `bind()` in each.

Importing a layer changes nothing in how scapy dissects; `bind()` makes it dissect the ports in use, `unbind()` ends
that. This machine's routes, which scapy reads by itself in a second where a fleet has many networks, are not read:
nothing here sends.
"""

from scapy.config import conf

conf.route_autoload = conf.route6_autoload = False

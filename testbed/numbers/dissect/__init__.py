"""scapy layers for the protocols of the testbed's nodes: `mavlink` (1 and 2) and `mqtt5`, each with a `bind()`.

Importing a layer does not change how scapy dissects: `bind()` makes it dissect the ports in use, `unbind()` undoes
that. scapy is kept from reading this machine's routes, which takes a second where a fleet has many networks: nothing
here sends.
"""

from scapy.config import conf

conf.route_autoload = conf.route6_autoload = False

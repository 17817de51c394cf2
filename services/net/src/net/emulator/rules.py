"""Which packets go to which queue: a rule of iptables for each directed link, and none may pass besides.

iptables, since a kernel may have NFQUEUE for iptables (CONFIG_NETFILTER_XT_TARGET_NFQUEUE) and not for nftables. No
`--queue-bypass`: while nobody listens to a queue, its packets are dropped, never let through unshaped.
"""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from dataclasses import dataclass

from ..hops import Link as Pair
from ..hops import next_hops
from ..interfaces import NetError, Port
from .plan import PlanError

ROOT_NODE = "cloud"
CHAIN = "NET-SHAPE"
TOOLS = ("iptables-restore", "iptables-legacy-restore")
"""The first works by nf_tables, which a kernel may lack."""


@dataclass(frozen=True)
class Way:
    """Where a directed link's packets come in and go out."""

    link: str
    source: Port
    destination: Port


def ways_of(names: Sequence[str], ports: Sequence[Port], pairs: Sequence[Pair]) -> tuple[Way, ...]:
    """`CLASS:NODE:up` leads from NODE to the next towards the cloud, `down` back. Raises PlanError.

    The names have to be exactly the links there are: a packet on any other would not be shaped.
    """
    by_node = {port.node: port for port in ports}
    hops = next_hops(pairs)
    found, seen = [], set()
    for name in names:
        _, node, direction = [*name.split(":"), "", ""][:3]
        upper = hops.get((node, ROOT_NODE))
        if name.count(":") != 2 or direction not in ("up", "down") or upper is None:
            known = ", ".join(node for node in by_node if node != ROOT_NODE)
            raise PlanError(f"links {name!r}: expected CLASS:NODE:up or CLASS:NODE:down, NODE of {known}")
        ends = (node, upper) if direction == "up" else (upper, node)
        if ends in seen:
            raise PlanError(f"links {name!r}: expected one link from {ends[0]} to {ends[1]}")
        seen.add(ends)
        found.append(Way(name, by_node[ends[0]], by_node[ends[1]]))
    missing = [f"{one} to {other}" for pair in pairs for one, other in (pair, pair[::-1]) if (one, other) not in seen]
    if missing:
        raise PlanError(f"links: none from {', '.join(missing)}; expected one each way for every pair of LINKS")
    return tuple(found)


def rules(ways: Sequence[Way]) -> str:
    """What iptables-restore has to do; queue numbers are the ways' places."""
    lines = [
        f"-A {CHAIN} -i {way.source.interface} -o {way.destination.interface} -j NFQUEUE --queue-num {queue}"
        for queue, way in enumerate(ways)
    ]
    return "\n".join(["*filter", ":FORWARD DROP", f":{CHAIN} -", f"-A FORWARD -j {CHAIN}", *lines, "COMMIT", ""])


def apply(ways: Sequence[Way]) -> None:
    """Raises NetError with what iptables says."""
    said = []
    for tool in TOOLS:
        try:
            done = subprocess.run([tool], input=rules(ways), capture_output=True, text=True, check=False)
        except FileNotFoundError:
            said.append(f"{tool}: not found")
            continue
        if done.returncode == 0:
            return
        said.append(f"{tool}: {' '.join(done.stderr.split())}")
    raise NetError(f"{'; '.join(said)}; expected iptables, CAP_NET_ADMIN and a kernel with NFQUEUE")

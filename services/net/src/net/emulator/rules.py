"""The rules that send packets to queues: one of iptables for each directed link; no other packet may pass.

iptables, because a kernel may have NFQUEUE for iptables (CONFIG_NETFILTER_XT_TARGET_NFQUEUE) and not for nftables. No
`--queue-bypass`: while no program listens to a queue, its packets are dropped, never passed on unshaped.
"""

from __future__ import annotations

import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..hops import NodePair, next_hops
from ..interfaces import NetError, Port
from .plan import PlanError

ROOT_NODE = "cloud"
SENSE = "sense"
CHAIN = "NET-SHAPE"
TOOLS = ("iptables-restore", "iptables-legacy-restore")
"""The first uses nf_tables, which a kernel may lack."""


@dataclass(frozen=True)
class Way:
    """The ports at which a directed link's packets enter and leave."""

    link: str
    source: Port
    destination: Port


def ways_of(names: Sequence[str], ports: Sequence[Port], pairs: Sequence[NodePair]) -> tuple[Way, ...]:
    """`CLASS:NODE:up` leads from NODE to the next node towards the cloud, `down` back; `sense:NODE:up` leads from the
    node beyond to NODE.

    The names must be exactly the existing links: a packet on any other would not be shaped. Raises PlanError.
    """
    by_node = {port.node: port for port in ports}
    hops = next_hops(pairs)
    found, seen = [], set()
    for name in names:
        kind, node, direction = [*name.split(":"), "", ""][:3]
        ends = _ends(kind, node, hops)
        if name.count(":") != 2 or direction not in ("up", "down") or ends is None:
            known = ", ".join(node for node in by_node if node != ROOT_NODE)
            raise PlanError(f"links {name!r}: expected CLASS:NODE:up or CLASS:NODE:down, NODE of {known}")
        source, destination = ends if direction == "up" else ends[::-1]
        if (source, destination) in seen:
            raise PlanError(f"links {name!r}: expected one link from {source} to {destination}")
        seen.add((source, destination))
        found.append(Way(name, by_node[source], by_node[destination]))
    missing = [f"{one} to {other}" for pair in pairs for one, other in (pair, pair[::-1]) if (one, other) not in seen]
    if missing:
        raise PlanError(f"links: none from {', '.join(missing)}; expected one each way for every pair of LINKS")
    return tuple(found)


def _ends(kind: str, node: str, hops: Mapping[NodePair, str]) -> NodePair | None:
    """The lower and the upper end of a link; None if no link has that name.

    A sense link has the name of the drone, its upper end: the sensor is the only node beyond it.
    """
    if kind == SENSE:
        beyond = [one for (one, to), first in hops.items() if to == ROOT_NODE and first == node]
        return (beyond[0], node) if len(beyond) == 1 else None
    upper = hops.get((node, ROOT_NODE))
    return None if upper is None else (node, upper)


def rules(ways: Sequence[Way]) -> str:
    """The input of iptables-restore; queue numbers are the indexes of the ways."""
    lines = [
        f"-A {CHAIN} -i {way.source.interface} -o {way.destination.interface} -j NFQUEUE --queue-num {queue}"
        for queue, way in enumerate(ways)
    ]
    return "\n".join(["*filter", ":FORWARD DROP", f":{CHAIN} -", f"-A FORWARD -j {CHAIN}", *lines, "COMMIT", ""])


def apply(ways: Sequence[Way]) -> None:
    """Put the rules into force, and read them back. Raises NetError with the error of iptables."""
    said = []
    for tool in TOOLS:
        try:
            done = subprocess.run([tool], input=rules(ways), capture_output=True, text=True, check=False)
        except FileNotFoundError:
            said.append(f"{tool}: not found")
            continue
        if done.returncode == 0:
            shown = subprocess.run([tool.removesuffix("-restore"), "-S"], capture_output=True, text=True, check=False)
            check(ways, shown.stdout)
            return
        said.append(f"{tool}: {' '.join(done.stderr.split())}")
    raise NetError(f"{'; '.join(said)}; expected iptables, CAP_NET_ADMIN and a kernel with NFQUEUE")


def check(ways: Sequence[Way], shown: str) -> None:
    """Raise NetError if the rules in force, as `iptables -S` shows them, are not the requested ones."""
    asked = [line for line in rules(ways).splitlines() if line.startswith("-A")]
    lines = shown.splitlines()
    found = [line for line in lines if line.startswith(("-A FORWARD", f"-A {CHAIN}"))]
    for place, line in enumerate(asked):
        there = found[place] if place < len(found) else "nothing"
        if there != line:
            raise NetError(f"iptables, rule {place + 1}: {there!r}; expected {line!r}")
    if len(found) > len(asked) or "-P FORWARD DROP" not in lines:
        raise NetError(
            f"iptables: {len(found)} rules for what is forwarded; expected {len(asked)}, and FORWARD to drop"
        )

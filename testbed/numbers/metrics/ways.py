"""The links at a node, and which of them lead towards the ground station."""

from __future__ import annotations

from ...plan.topology import Topology

STATION = "gs"
_DRONE = "uav"


class Ways:
    """The directed links of a topology by their ends. Its nodes are a tree."""

    def __init__(self, topology: Topology) -> None:
        self._ends = topology.ends
        self._nodes = [node.name for node in topology.nodes]

    @property
    def drones(self) -> dict[int, str]:
        """Each drone's node."""
        found = {name.removeprefix(_DRONE): name for name in self._nodes if name.startswith(_DRONE)}
        return {int(number): name for number, name in found.items() if number.isdecimal()}

    @property
    def fogs(self) -> dict[str, list[str]]:
        """The nodes of each fog's drones; a fog is a node that drones have a link to."""
        found: dict[str, list[str]] = {}
        for sender, receiver in self._ends.values():
            if sender in self.drones.values() and receiver not in self.drones.values() and self._is_above(receiver):
                found.setdefault(receiver, []).append(sender)
        return {fog: sorted(found[fog]) for fog in sorted(found)}

    @property
    def by_fog(self) -> dict[int, list[int]]:
        """The numbers of each fog's drones, by the fog's number."""
        named = {fog.removeprefix("fog"): self.drones_of(fog) for fog in self.fogs}
        return {int(number): drones for number, drones in named.items() if number.isdecimal()}

    def both(self, one: str, other: str) -> list[str]:
        """The directed links between two nodes."""
        return [name for name, ends in self._ends.items() if set(ends) == {one, other}]

    def drones_of(self, fog: str) -> list[int]:
        """The drones with a link to a fog."""
        near = {sender for sender, receiver in self._ends.values() if receiver == fog}
        return [drone for drone, node in self.drones.items() if node in near]

    @property
    def between(self) -> list[str]:
        """The nodes between station and drones: the cloud and the fogs."""
        ends = {STATION, *self.drones.values()}
        return [name for name in self._nodes if name not in ends and self._is_above(name)]

    def leaving(self, node: str) -> list[str]:
        return [name for name, (sender, _) in self._ends.items() if sender == node]

    def entering(self, node: str) -> list[str]:
        return [name for name, (_, receiver) in self._ends.items() if receiver == node]

    def through(self, node: str, up: bool) -> tuple[list[str], list[str]]:
        """The links on which messages reach a node and leave it, from the drones to the station (`up`) or back."""
        stationward = self._stationward(node)
        out_up = [name for name in self.leaving(node) if self._ends[name][1] == stationward]
        in_down = [name for name in self.entering(node) if self._ends[name][0] == stationward]
        if up:
            return [name for name in self.entering(node) if name not in in_down], out_up
        return in_down, [name for name in self.leaving(node) if name not in out_up]

    def _is_above(self, node: str) -> bool:
        """Whether a node lies between the drones and the station; a sensor does not."""
        return node == STATION or self._stationward(node) not in (None, *self.drones.values())

    def _stationward(self, node: str) -> str | None:
        """The next node on the way to the station."""
        parents: dict[str, str] = {}
        waiting = [STATION]
        while waiting:
            here = waiting.pop()
            for sender, receiver in self._ends.values():
                if sender == here and receiver != STATION and receiver not in parents:
                    parents[receiver] = here
                    waiting.append(receiver)
        return parents.get(node)

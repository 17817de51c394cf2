"""What the parts of one activator session have in common."""

from __future__ import annotations

from dataclasses import dataclass

from ..core.channel import Channel
from ..core.session_owners import SessionOwners
from ..protocol.topics import CloudSide, FogSide
from .leases import Leases


@dataclass(frozen=True)
class Site:
    """One activator session: the channels to both its brokers, their topics, and who its stations are."""

    session: int
    to_cloud: Channel
    to_fog: Channel
    cloud: CloudSide
    fog: FogSide
    leases: Leases
    owners: SessionOwners


class Part:
    """A part of an activator, which has all of its site."""

    def __init__(self, site: Site) -> None:
        self._session = site.session
        self._name = f"fog{site.cloud.fog}"
        self._to_cloud, self._to_fog = site.to_cloud, site.to_fog
        self._cloud, self._fog = site.cloud, site.fog
        self._leases, self._owners = site.leases, site.owners

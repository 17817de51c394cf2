"""A fog with one drone, as real processes, whose autopilot is always armed and whose brokers are the benchmarks'."""

from __future__ import annotations

from pathlib import Path

from mqttxt.security.authority import Authority
from tests.bench.always_armed import AlwaysArmed
from tests.bench.brokers import BenchBroker
from tests.rigs.one_drone import OneDrone
from tests.rigs.processes import Broker, Process
from tests.rigs.secure import SecureBroker


class ArmedDrone(OneDrone):
    """`mode` is as in OneDrone; the journal is in the folder `journals`."""

    autopilot: AlwaysArmed

    def __init__(self, folder: Path, journals: Path, mode: str = "") -> None:
        super().__init__(folder, mode)
        self.journal = journals / "journal"
        self.run([], ["--broker", self.url(self.fog.port)])

    def broker(
        self, of: str, authority: Authority | None, called: str | None = None, *, air: bool = False, prefix: str = ""
    ) -> Broker | SecureBroker:
        if authority is None:
            return BenchBroker(self.folder, called or of)
        return super().broker(of, authority, called, air=air, prefix=prefix)

    @property
    def processes(self) -> tuple[Process, ...]:
        return self.activator, self.uav

    async def begin(self) -> None:
        self.autopilot = AlwaysArmed(self._autopilot)
        await super().begin()

    async def end(self) -> None:
        self.autopilot.close()
        await super().end()

"""A fog with one drone and its sensor, all of them with identities: every connection is mutual TLS."""

from __future__ import annotations

from pathlib import Path

from mqttxt.security.rights import Rights
from tests.rigs.one_drone import SIGNED, TLS, OneDrone
from tests.rigs.processes import Process
from tests.rigs.secure import SecureBroker


class SecureSystem(OneDrone):
    """Adds the drone's own broker, a sensor that publishes there, and audit logs; `signed` covers readings, too."""

    def __init__(self, folder: Path, signed: bool = False, *of_the_drone: str, prefix: str = "") -> None:
        super().__init__(folder, SIGNED if signed else TLS, prefix=prefix)
        assert self.acme is not None
        self.signs_readings = signed
        self.acme.issue("sensor7")
        self.acme.issue("gs-view", Rights(observe=True))
        self.field = self.broker("drone1", self.acme)
        self.brokers.append(self.field)
        self.let_in()
        where, there = self.url(self.fog.port), self.url(self.field.port)
        signing = ["--signed-readings"] if signed else []
        uav = ["--broker", where, "--sensor-broker", there, "--sensor-store", str(folder / "readings")]
        self.run(
            ["--audit", str(folder / "fog1.audit"), "--prefix", prefix, *signing],
            [*uav, "--audit", str(folder / "drone1.audit"), *signing, *of_the_drone],
        )
        kinds = ["--number", "7", "--kinds", "temperature", "--rate", "5"]
        self.sensor = self.process("sensor", "sensor", "--broker", there, *kinds, *self.identity("sensor7"))

    @property
    def processes(self) -> tuple[Process, ...]:
        return *super().processes, self.sensor

    def let_in(self) -> None:
        """Add identities issued since the start to the brokers' access lists."""
        for broker in self.brokers:
            assert isinstance(broker, SecureBroker)
            broker.files.write_access(broker.out)

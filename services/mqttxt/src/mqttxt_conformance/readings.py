"""Readings that a sensor signs (R12.21): the kit sends them in the name of the fleet's sensor 4."""

from __future__ import annotations

import secrets

from mqttxt.protocol.codec import encode
from mqttxt.protocol.readings import ReadingAck, ReadingKey, ReadingMessage
from mqttxt.security.seal import Seal

from .registry import NotTested
from .sealed import Folder

SENSOR, KIND = 4, "temperature"
OTHER_KIND = "humidity"


class Sensor:
    """One start of the sensor; raises NotTested if the fleet has no such sensor or does not sign readings."""

    def __init__(self, folder: Folder) -> None:
        if not folder.signed_readings:
            raise NotTested("needs --signed-readings, of the kit and of the implementation")
        if not (folder.path / f"sensor{SENSOR}").is_dir():
            raise NotTested(f"needs a sensor: mqttxt keys issue sensor {SENSOR}")
        self.seal = folder.seal(f"sensor{SENSOR}")
        self.boot = secrets.randbelow(2**32 - 1) + 1

    def measured(self, seq: int) -> bytes:
        """A reading, unsigned."""
        return encode(ReadingMessage(boot=self.boot, seq=seq, time_ms=1_700_000_000_000, value=21.5))

    def said(self, seq: int, by: Seal | None = None, kind: str = KIND) -> bytes:
        """A reading signed by the sensor, or with the seal `by`."""
        signer = by or self.seal
        return signer.sign(f"sensor{SENSOR}/{kind}", self.measured(seq), with_certificate=True).encode()

    def named(self, seq: int) -> bytes:
        """An acknowledgement of a reading, unsigned."""
        return encode(ReadingAck(readings=(ReadingKey(sensor=SENSOR, boot=self.boot, seq=seq),)))

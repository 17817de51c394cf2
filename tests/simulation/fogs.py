"""An activator whose two brokers are the test itself."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from mqttxt.activator.role import Activator
from mqttxt.core.effects import Audit, Effect, Inbound, Publish, Subscribe
from mqttxt.core.settings import Settings
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm, Command
from mqttxt.protocol.control import Control, DroneLease, DroneRecord, Registration
from mqttxt.protocol.messages import BeaconMessage, Presence, ResultMessage, Word
from mqttxt.protocol.rankings import SelectMessage, SelectMode
from mqttxt.protocol.state_payload import StampedState, encode_state
from mqttxt.protocol.states import Battery, State
from mqttxt.protocol.values import Encoding
from tests.simulation.world import FOG_SESSION, GS_SESSION, UAV_SESSION, command_payload

BORN_MS = 10_000
UAV_AHEAD_MS = 90_000
"""The drone's session clock reads this much more than the activator's."""


def of(effects: list[Any], topic: str) -> list[Publish]:
    return [e for e in effects if isinstance(e, Publish) and e.topic == topic]


def words(effects: list[Any], drone: int = 1) -> list[tuple[Word, str | None]]:
    start = f"fog1/drone{drone}/commands_result/"
    found = [decode(ResultMessage, e.payload) for e in effects if isinstance(e, Publish) and e.topic.startswith(start)]
    return [(result.word, result.reason) for result in found]


class ActivatorBench:
    """An activator whose two brokers are this test."""

    def __init__(self, drones: tuple[int, ...] = (1,), born: bool = True, qos: int = 1) -> None:
        self.role = Activator(1, FOG_SESSION, Settings(qos=qos), drones=drones)
        self.now_ms = BORN_MS
        self.audited: list[Audit] = []
        for subscribe in self.role.on_connected("fog", self.now_ms):
            self.role.on_subscribed(subscribe, self.now_ms)  # type: ignore[arg-type]
        self.subscribes = [e for e in self.role.on_connected("cloud", self.now_ms) if isinstance(e, Subscribe)]
        self.beacons = [e for s in self.subscribes for e in self.role.on_subscribed(s, self.now_ms)]
        self.birth: list[Any] = []
        if born:
            self.birth = self.be_shown()

    def be_shown(self, *records: tuple[int, DroneRecord]) -> list[Any]:
        """End what the broker retains by wildcard, and deliver `records` to filters that name their drones in full."""
        own = BeaconMessage(session=FOG_SESSION, now_ms=self.now_ms)
        out = self.cloud("clock", own)
        named = [effect for effect in out if isinstance(effect, Subscribe)]
        for subscribe in named:
            for drone, record in records:
                assert f"fog1/drone{drone}/reachable" in subscribe.filters
                self.cloud(f"drone{drone}/reachable", record, retain=True)
            out += self.role.on_subscribed(subscribe, self.now_ms)
        return out + self.cloud("clock", own) if named else out

    def cloud(self, rest: str, message: Any, retain: bool = False) -> list[Any]:
        payload = message if isinstance(message, bytes) else encode(message)
        return self._done(self.role.on_message("cloud", Inbound(f"fog1/{rest}", payload, 1, retain), self.now_ms))

    def fog(self, topic: str, message: Any) -> list[Any]:
        payload = message if isinstance(message, bytes) else encode(message)
        return self._done(self.role.on_message("fog", Inbound(topic, payload, 1), self.now_ms))

    def until(self, now_ms: int) -> list[Any]:
        out: list[Any] = []
        while self.now_ms < now_ms:
            self.now_ms += 100
            out += self._done(self.role.tick(self.now_ms))
        return out

    def _done(self, effects: Iterable[Effect]) -> list[Any]:
        """The activator's effects without its audit records, which are kept apart."""
        found = list(effects)
        self.audited += [effect for effect in found if isinstance(effect, Audit)]
        return [effect for effect in found if not isinstance(effect, Audit)]

    def appear(self, drone: int = 1, session: int = UAV_SESSION) -> list[Any]:
        """Let a UAV client publish its birth and echo the activator's nonce."""
        out = self.fog(f"drone{drone}/reachable", Presence(session=session, up=True))
        (lease,) = of(out, f"drone{drone}/init_connect")
        return out + self.echo(decode(DroneLease, lease.payload).nonce, drone, session)

    def echo(self, nonce: int | None = None, drone: int = 1, session: int = UAV_SESSION) -> list[Any]:
        held_ms = 0 if nonce is not None else None
        beacon = BeaconMessage(session=session, now_ms=self.now_ms + UAV_AHEAD_MS, nonce=nonce, held_ms=held_ms)
        return self.fog(f"drone{drone}/clock", beacon)

    def command(self, command: Command | None = None, to: str = "drone1/commands", **changed: Any) -> list[Any]:
        fields = {"executor_session": FOG_SESSION, "deadline_ms": self.now_ms + 5000, **changed}
        retain = fields.pop("retain", False)
        return self.cloud(to, command_payload(command or Arm(), **fields), retain)

    def result(self, word: Word, session: int = UAV_SESSION, **changed: Any) -> list[Any]:
        stamp = (self.now_ms + UAV_AHEAD_MS) // 10 % 65536
        fields = {"gs_session": GS_SESSION, "seq": 1, "session": session, "stamp": stamp, "word": word}
        return self.fog("drone1/commands_result/arm", ResultMessage(**{**fields, **changed}))  # type: ignore[arg-type]

    def register(
        self,
        lease_s: int = 30,
        name: str = "alpha",
        session: int = GS_SESSION,
        control: Control = Control.WANT,
        **more: Any,
    ) -> list[Any]:
        fields = {"name": name, "session": session, "nonce": 7, "lease_s": lease_s, "control": control}
        return self.cloud("init_connect", Registration(**{**fields, **more}))

    def state(self, remaining: int = 50, stamped_ms: int | None = None) -> list[Any]:
        own_ms = (self.now_ms if stamped_ms is None else stamped_ms) + UAV_AHEAD_MS
        state = StampedState(Battery(remaining), own_ms // 10 % 65536)
        return self.fog("drone1/state/battery", encode_state(state, Encoding.CBOR))

    def tell(self, *states: State, drone: int = 1) -> list[Any]:
        """Publish a drone's states, stamped now."""
        own_ms = self.now_ms + UAV_AHEAD_MS
        out: list[Any] = []
        for state in states:
            payload = encode_state(StampedState(state, own_ms // 10 % 65536), Encoding.CBOR)
            out += self.fog(f"drone{drone}/state/{state.name}", payload)
        return out

    def select(self, command: Command, seq: int = 1, **changed: Any) -> list[Any]:
        """Send a command for the drone that PSMI chooses."""
        fields = {"gs_session": GS_SESSION, "seq": seq, "executor_session": FOG_SESSION, "limit_s": 60.0}
        fields |= {"deadline_ms": self.now_ms + 5000, "mode": SelectMode.SELECT, "command": command, **changed}
        return self.cloud(f"commands/{command.name}", SelectMessage(**fields))  # type: ignore[arg-type]

    def word(self, drone: int, word: Word, seq: int = 1, reason: str | None = None) -> list[Any]:
        """Publish a drone's word about a goto."""
        stamp = (self.now_ms + UAV_AHEAD_MS) // 10 % 65536
        result = ResultMessage(
            gs_session=GS_SESSION, seq=seq, session=UAV_SESSION + drone, stamp=stamp, word=word, reason=reason
        )
        return self.fog(f"drone{drone}/commands_result/goto", result)


def ready(controlled: bool = True, **how: Any) -> ActivatorBench:
    """A bench whose drone 1 is reachable and, unless the gate is to be closed, controlled by station alpha."""
    bench = ActivatorBench(**how)
    bench.appear()
    if controlled:
        bench.register()
    return bench

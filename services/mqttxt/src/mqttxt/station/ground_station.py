"""The ground station's public API, on asyncio (docs/api.md)."""

from __future__ import annotations

import secrets
import ssl
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from ..core.address import BrokerAddress, host_port
from ..core.clock import SessionClock
from ..core.settings import CONNECT_S, Settings
from ..core.transport import Transport
from ..errors import ConfigurationError, FogUnreachable, SigningDiffers
from ..protocol.commands import Command
from ..protocol.names import MAX_DRONE, check_number, check_station_name, in_fleet
from ..protocol.values import Encoding
from ..security.names import Kind
from .best import best
from .heard import EventStream, SentCommand
from .outcomes import Outcome, PsmiList
from .process import StationRunner, check_timeout, leave
from .readiness import missing, share_list, signs_otherwise
from .role import StationRole
from .views import TAKEOVER_S, TTL_S, Drone, Fog

if TYPE_CHECKING:
    from ..security.identity import Identity


class GroundStation:
    """A ground station at a cloud broker: an asynchronous context manager.

        async with GroundStation("mqtt://cloud.example:1883") as gs:
            (fog,) = await gs.connect([1])
            outcome = await fog.drone(1).takeoff(10)

    Inside `async with` it connects, reconnects and receives; leaving gives up the control that it has. Leaving raises
    BrokerRefused where the broker refused the connection or a subscription for good. It can be entered once.

    Parameters:
        url: `mqtt://[user:password@]host[:port]`, or `mqtts://…` for TLS.
        name: the station's name, 1 to 64 letters, digits, `_`, `.` or `-`; None: a random one.
        qos: MQTT's quality of service of commands, 0 or 1.
        encoding: the encoding of payloads that it sends; it reads both.
        prefix: the prefix of every topic, as `acme/`.
        control: take control of every drone that is free; False: only watch; drones' numbers: of these alone.
        bundles: receive states in bundles, at most once per second, and a broadcast's words together.
        ssl_context: trust and certificate for `mqtts://` without an identity; None: trust the system's authorities.
        identity: the folder of this station's identity (`mqttxt keys issue station`), for `mqtts://` to a broker of
            its fleet; the station's name is then that of the identity.
        signed: sign commands end to end, for their drones, and accept only signed messages; needs an identity. The
            whole fleet signs, or none of it does.
        signed_states: accept only signed states, too; needs `signed`, and a whole fleet that signs states.
        signed_readings: accept only readings that their sensors signed; needs `signed`, and a fleet that does so.
        insecure: allow `mqtt://` to other machines: nothing is encrypted, and anybody can command the drones.
        clock: the clock of this session; None: a new one on the system's monotonic clock.

    Raises:
        ConfigurationError: an invalid parameter; the message names it.
    """

    def __init__(
        self,
        url: str,
        *,
        name: str | None = None,
        qos: int = 1,
        encoding: Encoding = Encoding.CBOR,
        prefix: str = "",
        control: bool | Iterable[int] = True,
        bundles: bool = False,
        ssl_context: ssl.SSLContext | None = None,
        identity: Path | str | None = None,
        signed: bool = False,
        signed_states: bool = False,
        signed_readings: bool = False,
        insecure: bool = False,
        clock: SessionClock | None = None,
    ) -> None:
        if qos not in (0, 1):
            raise ConfigurationError(f"qos {qos}: expected 0 or 1")
        if not isinstance(encoding, Encoding):
            raise ConfigurationError(f"encoding {encoding!r}: expected Encoding.CBOR or Encoding.JSON")
        if ssl_context is not None and identity is not None:
            raise ConfigurationError("ssl_context: expected none beside identity")
        own: Identity | None = None
        if identity is not None:
            from ..security.identity import Identity

            own = Identity.load(Path(identity))
        own_name = _name_of(name, own)
        own_clock = clock or SessionClock()
        settings = Settings(qos=qos, encoding=encoding, bundles=bundles)
        transport = Transport(own, insecure)
        seal = transport.seal(signed, signed_states, signed_readings)
        role = StationRole(own_name, own_clock.session, settings, prefix=prefix, control=control, seal=seal)
        address = transport.check(BrokerAddress.parse(url), "broker")
        self._runner = StationRunner(role, address, own_clock, ssl_context, own)
        self._broker = host_port(address.host, address.port)

    @property
    def name(self) -> str:
        """The station's name."""
        return self._runner.station.name

    @property
    def prefix(self) -> str:
        """The prefix of its fleet's topics, as `acme/`; empty for none."""
        return self._runner.station.prefix

    @property
    def broker(self) -> str:
        """The host and port of its broker."""
        return self._broker

    @property
    def session(self) -> int:
        """The number of this session: it leads the ids of its commands."""
        return self._runner.station.session

    async def __aenter__(self) -> Self:
        self._runner.begin()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await leave(self._runner)
        if error is None:
            self._runner.result()

    async def connect(self, fogs: Iterable[int], timeout_s: float = CONNECT_S) -> list[Fog]:
        """Register at fogs, and return them once each has confirmed; drones may become reachable later.

        Parameters:
            fogs: the fogs' numbers.
            timeout_s: how long to wait, in seconds.

        Raises:
            FogUnreachable: a fog has not confirmed in time. For each such fog the message names what is missing: the
                connection to the broker and why, the activator, or its confirmation. The station goes on trying.
            ConfigurationError: an invalid fog number, a timeout that is not above 0, or a station that was not entered
                (`async with`).
            StationEnded, BrokerRefused: the station has ended.
        """
        runner = self._runner
        numbers = [check_number("fog", number) for number in fogs]
        check_timeout(timeout_s)
        if not runner.has_begun:
            raise ConfigurationError("connect: expected a station that was entered, by `async with GroundStation(…)`")
        runner.check()
        runner.carry_out(runner.station.add_fogs(numbers))
        views = [runner.station.fogs[number] for number in numbers]
        try:
            await runner.wait_until(lambda: all(view.is_ready(runner.clock.now_ms()) for view in views), timeout_s)
        except TimeoutError:
            late = [view for view in views if not view.is_ready(runner.clock.now_ms())]
            lacks = "; ".join(f"fog {view.number}: {missing(runner, view)}" for view in late)
            kind = SigningDiffers if any(signs_otherwise(runner, view) for view in late) else FogUnreachable
            raise kind(f"{lacks} (waited {timeout_s:g} s)") from None
        return [Fog(runner, view) for view in views]

    @property
    def fogs(self) -> list[Fog]:
        """Every fog that `connect` was called with."""
        return [Fog(self._runner, view) for view in self._runner.station.fogs.values()]

    @property
    def drones(self) -> list[Drone]:
        """Every drone that is known to one of its fogs, fog by fog."""
        return [drone for fog in self.fogs for drone in fog.drones]

    def fog(self, number: int) -> Fog:
        """A fog that `connect` was called with.

        Parameters:
            number: the fog's number.

        Raises:
            FogUnreachable: `connect` was not called with it.
        """
        return Fog(self._runner, self._runner.station.fog(number))

    def drone(self, number: int) -> Drone:
        """A drone that is known to a fog; where several know it, as seen by the one that reports it as reachable.

        Parameters:
            number: the drone's number, 1 to 250.

        Raises:
            FogUnreachable: no fog that `connect` was called with knows it, or several report it as reachable.
            ConfigurationError: an invalid drone number.
        """
        check_number("drone", number, MAX_DRONE)
        known = [drone for drone in self.drones if drone.number == number]
        reached = [drone for drone in known if drone.is_reachable] or known[:1]
        if len(reached) != 1:
            fogs = ", ".join(in_fleet(drone.fleet, drone.fog) for drone in reached)
            wrong = f"fogs {fogs} each say that it is reachable" if fogs else "no fog that is connected knows it"
            raise FogUnreachable(f"drone {in_fleet(self._runner.fleet, number)}: {wrong}")
        return reached[0]

    def events(self) -> EventStream:
        """Every event from this call on, as an asynchronous iterator that ends with the station.

        It yields `Outcome`, `StateUpdate`, `Reachability`, `ControlChanged`, `PsmiList`, `QodsRanking`,
        `SensorReading` and `ListBehind`. Raises nothing; iterating raises BrokerRefused where the broker ended the
        station.
        """
        return self._runner.listen()

    async def reload(self) -> None:
        """Load the identity again: a renewed key signs from now on, and a newer revocation list takes effect.

        Raises nothing: an unusable identity is logged and changes nothing. Without an identity it does nothing.
        """
        await self._runner.reload()

    async def share_list(self, timeout_s: float = CONNECT_S) -> int:
        """Wait until the cloud broker has this station's revocation list, or a newer one; returns the list's number.

        A station with an identity publishes its list anyway; this method waits until the broker has it.

        Parameters:
            timeout_s: how long to wait, in seconds.

        Raises:
            FogUnreachable: the broker does not show it in time; the message says what is missing.
            ConfigurationError: the station has no identity, or the timeout is not above 0.
            StationEnded, BrokerRefused: the station ends before.
        """
        if self._runner.identity is None:
            raise ConfigurationError("share_list: expected a station with an identity")
        return await share_list(self._runner, timeout_s)

    async def wait_until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        """Wait until a condition holds. It is evaluated after every message, and twenty times per second.

        Parameters:
            condition: called without arguments; returns whether it holds.
            timeout_s: how long to wait, in seconds.

        Raises:
            TimeoutError: the condition does not hold in time.
            ConfigurationError: the timeout is not above 0.
            StationEnded, BrokerRefused: the station ends before.
        """
        await self._runner.wait_until(condition, timeout_s)

    def best(
        self,
        command: Command,
        fogs: Iterable[int | Fog] | None = None,
        *,
        ttl_s: float = TTL_S,
        limit_s: float | None = None,
    ) -> SentCommand[Outcome, Outcome | PsmiList]:
        """Send a command to the drone that arrives first (PSMI); `await` gives that drone's last word.

        A single fog chooses itself, and tries the next drone after a definite no. Where there are several fogs, or
        commands are signed, each fog reserves its best drone and the best of these gets the command; after a definite
        no, the next. `async for` yields PSMI's lists too. If no drone was sent, the answer has no `drone` but a reason.
        The choice goes on, awaited or not, until a drone is sent or `ttl_s` has passed; `Hold`, `Land` or `Return` from
        this station ends it, also one that could not be sent.

        Parameters:
            command: a `Goto`.
            fogs: the fogs among which to choose, or their numbers; None: all that `connect` was called with.
            ttl_s: seconds within which the execution must start, at most 60; among several fogs from their offers on,
                for which `best` waits as long at the most.
            limit_s: seconds within which the execution must end; None: the command's own limit.

        Raises:
            FogUnreachable: none of the activators is live; nothing was sent. Awaiting raises it where none of several
                fogs answered, or the last one was lost before the command was sent to it.
            ConfigurationError: a command other than `Goto`, or an invalid time; nothing was sent.
            PayloadError: a field of the command that cannot be encoded; nothing was sent.
            StationEnded, BrokerRefused: the station has ended; nothing was sent.
        """
        chosen = self.fogs if fogs is None else fogs
        places = [(self._runner, fog) if isinstance(fog, int) else fog._place for fog in chosen]
        return best(places, command, ttl_s, limit_s)

    async def take_over(self, fog: int, drones: tuple[int, ...] | None = None, timeout_s: float = TAKEOVER_S) -> None:
        """Take control of a fog's drones from any holder; the drones' records tell all stations.

        A station with `control=False` or drones' numbers keeps those alone that it wants or has claimed.

        Parameters:
            fog: the fog's number.
            drones: the drones' numbers; None: all of the fog.
            timeout_s: how long to wait for the confirmation, in seconds.

        Raises:
            FogUnreachable: `connect` was not called with the fog, its activator is not live, or it has not confirmed in
                time.
            ConfigurationError: an invalid drone number, or a timeout that is not above 0.
            StationEnded, BrokerRefused: the station has ended.
        """
        await self.fog(fog).take_over(drones, timeout_s)


def _name_of(name: str | None, identity: Identity | None) -> str:
    """The station's name: that of its identity, the given one, or a random one; raises ConfigurationError."""
    if identity is None:
        return check_station_name(name) if name is not None else f"gs-{secrets.token_hex(4)}"
    node = identity.certificate.node
    if node.kind is not Kind.STATION or name not in (None, node.label):
        expected = "a station's" if name is None else f"that of gs-{name}"
        raise ConfigurationError(f"identity {identity.folder}: the identity of {identity.name}; expected {expected}")
    return node.label

"""The messages about registration at a fog and control of drones (docs/protocol.md, section 6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from .fields import U32, VERSION, DroneNumber, Integer, Items, Milliseconds, Named, Session, StationName, Version


class Control(Named):
    """What a registering station wants: only to watch, control of what is free, or control of what others hold too."""

    NONE = 0
    WANT = 1
    TAKE = 2


@dataclass(frozen=True, kw_only=True)
class Registration:
    """A ground station's lease at a fog (`fogX/init_connect`); `lease_s` 0 ends it.

    `control` says what the station wants of the drones in `drones` (of all, where they are absent); `bundles` true
    asks for states as `fogX/states`, and for words that leave together (R10.6). `until_ms` is the lease's end in
    the activator's clock, as a command's deadline is made; a takeover names the `epoch` that the station has seen.
    `anew` true: the registration is not confirmed on this connection, and what the fog said before may be missing;
    then it names the `activator_session` whose birth the station has heard. Where messages are signed that is named
    always, and `counter` rises with each.
    """

    version: Version = VERSION
    name: StationName
    session: Session
    nonce: U32
    lease_s: Annotated[int, Integer(0, 3600)]
    control: Control | None = None
    bundles: bool | None = None
    drones: Annotated[tuple[DroneNumber, ...], Items(250)] | None = None
    until_ms: Milliseconds | None = None
    epoch: U32 | None = None
    activator_session: Session | None = None
    counter: U32 | None = None
    anew: bool | None = None


@dataclass(frozen=True, kw_only=True)
class DroneLease:
    """The activator's word to the UAV client of one session (`droneY/init_connect`): a nonce to echo, and control.

    `bound` false tells a second UAV client of the same number that it is refused. While a station controls the
    drone, `holder_session` names it and the lease ends at `deadline_ms` of the drone's clock; while an offboard
    command of it is open, that may go on until `offboard_until_ms`. `counter` rises with each lease of a drone. Where
    messages are signed, `heard_ms` is the newest time of the drone's clock that the activator has heard, and `holder`
    is the name of the station whose session it is. `anew` true: the activator's connection is a new one, and what the
    drone said before may be lost.
    """

    version: Version = VERSION
    activator_session: Session
    drone_session: Session
    nonce: U32
    bound: bool
    epoch: U32 = 0
    holder_session: Session | None = None
    deadline_ms: Milliseconds | None = None
    offboard_until_ms: Milliseconds | None = None
    counter: U32 | None = None
    heard_ms: Milliseconds | None = None
    anew: bool | None = None
    holder: StationName | None = None


@dataclass(frozen=True, kw_only=True)
class Grant:
    """A ground station's own word on its control of a drone, where messages are signed.

    On `fogX/droneY/control`, passed on as `droneY/control`: it lasts until `until_ms` of the drone's clock at the
    latest, an offboard command of it until `offboard_until_ms`, whatever lease the activator gives.
    """

    version: Version = VERSION
    gs_session: Session
    drone_session: Session
    until_ms: Milliseconds
    offboard_until_ms: Milliseconds | None = None


@dataclass(frozen=True, kw_only=True)
class DroneRecord:
    """Whether a drone is reachable, and who controls it (`fogX/droneY/reachable`).

    In the words of the activator session that says so. `holder` is the controlling station's name, absent while
    nobody controls the drone; `epoch` rises with each takeover.
    """

    version: Version = VERSION
    activator_session: Session
    up: bool
    drone_session: Session | None = None
    holder: StationName | None = None
    holder_session: Session | None = None
    epoch: U32 | None = None

"""`mqttxt uav`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..core.address import BrokerAddress
from ..drone.logs import DEFAULT_LIMIT_MB
from ..drone.sensors import DEFAULT_LIMIT
from ..errors import ConfigurationError
from ..protocol.names import MAX_DRONE, check_number, check_root
from ..protocol.topics import FogSide
from .common import (
    AuditPath,
    AuditRequired,
    IdentityFolder,
    Insecure,
    Signed,
    SignedReadings,
    SignedStates,
    audit_log,
    check_system,
    named,
    run_role,
    set_up_logging,
    settings,
)
from .node_options import (
    BrokerIdentity,
    Json,
    Qos,
    Ready,
    Verbose,
    autopilot_address,
    embedded_broker,
    second_address,
)

if TYPE_CHECKING:
    from ..core.transport import Transport
    from ..drone.mavlink.signing import Signing
    from ..drone.process import UavRunner
    from ..drone.sensors.port import SensorOptions

NO_SENSORS = "expected --sensors or --sensor-broker beside it"


def uav(
    drone: Annotated[int, typer.Option(help="This drone's number: its autopilot's MAVLink system id.")],
    broker: Annotated[
        str, typer.Option(help="The fog's broker: mqtt://HOST[:PORT]; or mqtt-sn://HOST[:PORT], by UDP.")
    ],
    second_broker: Annotated[
        str | None,
        typer.Option(
            help="A second address of the fog, over another network: of its broker, or of its second one. Both stay up."
        ),
    ] = None,
    autopilot: Annotated[
        str, typer.Option(help="udp:HOST:PORT (listen), tcp:HOST:PORT or serial:DEVICE:BAUD.")
    ] = "udp:127.0.0.1:14540",
    journal: Annotated[
        Path | None, typer.Option(help="File that survives a restart and says which commands were open.")
    ] = None,
    fog_root: Annotated[str, typer.Option(help="Root of the fog side's topics, as fog1/local/.")] = "",
    bundles: Annotated[
        bool, typer.Option("--bundles", help="Publish states together, at most once a second, in one message.")
    ] = False,
    all_states: Annotated[
        bool,
        typer.Option("--all-states", help="Publish the states on request too, as MAVLink at the ground needs them."),
    ] = False,
    endurance_s: Annotated[
        int | None, typer.Option(help="Seconds of flight of a full battery; measured in flight without.")
    ] = None,
    allow_mav_cmd: Annotated[
        list[int] | None, typer.Option(help="A guarded MAV_CMD that `mavlink` may send; may be given several times.")
    ] = None,
    allow_component: Annotated[
        list[int] | None, typer.Option(help="A component beside the autopilot that `mavlink` may command.")
    ] = None,
    allow_parameter: Annotated[
        list[str] | None, typer.Option(help="A guarded parameter that may be set; may be given several times.")
    ] = None,
    parameter_ranges: Annotated[
        Path | None,
        typer.Option(help="What a parameter may be: PX4's parameters.json (.xz) or ArduPilot's apm.pdef.json."),
    ] = None,
    logs: Annotated[
        Path | None, typer.Option(help="Folder that keeps the autopilot's flight logs that stations ask for.")
    ] = None,
    logs_limit_mb: Annotated[
        int, typer.Option(help="Millions of bytes that the folder may hold; a log may have half of them.")
    ] = DEFAULT_LIMIT_MB,
    sensors: Annotated[
        str | None, typer.Option(help="HOST:PORT of an embedded broker where sensors publish; without: none is run.")
    ] = None,
    sensor_broker: Annotated[
        str | None, typer.Option(help="A broker for sensors that runs elsewhere, instead of the embedded one.")
    ] = None,
    sensor_store: Annotated[
        Path | None, typer.Option(help="File that keeps readings until the activator has acknowledged them.")
    ] = None,
    sensor_store_limit: Annotated[int, typer.Option(help="Readings that the file may hold.")] = DEFAULT_LIMIT,
    identity: IdentityFolder = None,
    broker_identity: BrokerIdentity = None,
    signed: Signed = False,
    signed_states: SignedStates = False,
    signed_readings: SignedReadings = False,
    fog: Annotated[
        int | None, typer.Option(help="With --signed: the fog's number; only its activator's leases count.")
    ] = None,
    insecure: Insecure = False,
    mavlink_key: Annotated[
        Path | None, typer.Option(help="The autopilot's MAVLink key: sign, and hear only what is signed with it.")
    ] = None,
    audit: AuditPath = None,
    audit_required: AuditRequired = False,
    qos: Qos = 1,
    json: Json = False,
    ready_file: Ready = None,
    verbose: Verbose = False,
) -> None:
    """Run a drone's UAV client: the interpreter between its autopilot and MQTT."""
    check_system("uav")
    from ..core.transport import Transport
    from ..drone.journal import JournalFile
    from ..drone.logs.files import LogFiles
    from ..drone.mavlink.raw import Limits
    from ..drone.options import UavOptions
    from ..drone.parameter_file import ParameterFile
    from ..drone.process import UavRunner

    set_up_logging(verbose)

    def make() -> UavRunner:
        number = check_number("--drone", drone, MAX_DRONE)
        if sensors is None and sensor_broker is None:
            if sensor_store is not None:
                raise ConfigurationError(f"--sensor-store {sensor_store}: {NO_SENSORS}")
            if sensor_store_limit != DEFAULT_LIMIT:
                raise ConfigurationError(f"--sensor-store-limit {sensor_store_limit}: {NO_SENSORS}")
        store = sensor_store or _default_state(number, "sensors")
        journal_file = journal or _default_state(number, "journal")
        if logs_limit_mb < 1:
            raise ConfigurationError(f"--logs-limit-mb {logs_limit_mb}: expected 1 or more")
        transport = Transport.of(identity, insecure, f"drone{number}")
        first = transport.check(BrokerAddress.parse(broker, "--broker", datagrams=True), "--broker", signed)
        second = second_address(second_broker, "--second-broker", transport, first)
        carried = sensor_options(sensors, sensor_broker, store, sensor_store_limit, transport, broker_identity)
        return UavRunner(
            number,
            first,
            autopilot_address(autopilot),
            JournalFile(journal_file, with_front=True),
            settings(qos, json, bundles),
            second=second,
            topics=FogSide(check_root(fog_root)),
            ready_file=ready_file,
            options=UavOptions(
                endurance_s,
                Limits(
                    mav_cmds=frozenset(allow_mav_cmd or ()),
                    components=frozenset(allow_component or ()),
                    parameters=frozenset(allow_parameter or ()),
                    ranges=_ranges(parameter_ranges) if parameter_ranges is not None else {},
                ),
                carries_sensors=carried is not None,
                all_states=all_states,
                keeps_logs=True,
            ),
            sensors=carried,
            identity=transport.identity,
            seal=transport.seal(signed, signed_states, signed_readings),
            fog=_own_fog(fog, signed),
            signing=_signing(mavlink_key, journal_file) if mavlink_key is not None else None,
            audit=audit_log(audit, audit_required, f"drone{number}", transport),
            parameters=ParameterFile(journal_file.with_name(f"{journal_file.name}.parameters")),
            logs=LogFiles(logs or journal_file.with_name(f"{journal_file.name}.logs"), 1_000_000 * logs_limit_mb),
        )

    run_role(make)


def _own_fog(fog: int | None, signed: bool) -> int:
    """The fog of a signing drone, 0 without `--signed`; raises ConfigurationError."""
    if not signed and fog is not None:
        raise ConfigurationError(f"--fog {fog}: expected --signed beside it")
    if signed and fog is None:
        raise ConfigurationError("--signed: expected --fog X, the fog's number, beside it")
    return check_number("--fog", fog) if fog is not None else 0


def _signing(key: Path, journal: Path) -> Signing:
    from ..drone.mavlink import signing

    with named("--mavlink-key"):
        return signing.Signing.load(key, journal)


def _ranges(path: Path) -> dict[str, tuple[float, float]]:
    from ..drone import parameter_ranges

    with named("--parameter-ranges"):
        return parameter_ranges.load(path)


def sensor_options(
    listen: str | None,
    elsewhere: str | None,
    store: Path,
    limit: int,
    transport: Transport,
    broker_identity: Path | None = None,
) -> SensorOptions | None:
    """The broker of the sensors and the store of their readings, None without one; raises ConfigurationError."""
    from ..drone.sensors.port import SensorOptions

    if listen is not None and elsewhere is not None:
        raise ConfigurationError(f"--sensor-broker {elsewhere!r}: expected no --sensors beside it")
    if limit < 1:
        raise ConfigurationError(f"--sensor-store-limit {limit}: expected 1 or more")
    if broker_identity is not None and listen is None:
        raise ConfigurationError(f"--broker-identity {broker_identity}: expected --sensors beside it")
    if elsewhere is not None:
        address = BrokerAddress.parse(elsewhere, "--sensor-broker")
        return SensorOptions(transport.check(address, "--sensor-broker"), store, limit)
    if listen is None:
        return None
    embedded = embedded_broker(listen, transport, broker_identity, "--sensors", "--sensor-broker")
    return SensorOptions(BrokerAddress.parse(embedded.url), store, limit, embedded)


def _default_state(drone: int, what: str) -> Path:
    state = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(state) / "mqttxt" / f"drone{drone}.{what}"

"""A series of both protocols made by hand, as the report reads it, with numbers for mental arithmetic."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from testbed.fly.results import METRICS, Attempt, Series, new_attempt, write_json
from testbed.numbers.metrics.attempt import NOT_FLOWN
from testbed.numbers.metrics.series import METRICS_VERSION, schema_error
from testbed.numbers.observed import observe
from testbed.numbers.packets import table
from testbed.numbers.quantities import ratios, statistics
from testbed.numbers.statistics import loss_of
from tests.handmade.attempts import SECOND, T0, manifest, write_lines

DRONES = (1, 2, 3, 4, 5, 6)
FACTORS = {"streams": "px4-onboard", "commanding": "one-by-one", "qos": 0, "chain": "per-uav", "states": "on-change"}
MISSION_S = {"mqttxt": 36.5, "mavlink": 60.2}
PACKETS = {"mqttxt": 1_700, "mavlink": 450_500}
SIZES = {"mqttxt": 146_000, "mavlink": 42_048_000}
STREAMS = {"ATTITUDE": (100.0, 82), "HIGHRES_IMU": (50.0, 115), "ODOMETRY": (30.0, 271), "HEARTBEAT": (1.0, 63)}
CPU = {
    "mqttxt": {"gs": 0.9, "broker": 0.4, "activator1": 1.0, "client1": 2.5, "sitl1": 2.0, "net": 1.0, "cloud": 0.01},
    "mavlink": {"gs": 21.0, "router-gs": 9.0, "router-cloud": 9.5, "router-uav1": 2.5, "sitl1": 6.0, "net": 30.0},
}


def entry(protocol: str, number: int = 1, **changed: Any) -> dict[str, Any]:
    """An attempt's entry in `metrics.json`."""
    layers = {"payload": 0.2, "mqtt": 0.1, "tcp": 0.4, "ip": 0.2, "ethernet": 0.1}
    if protocol == "mavlink":
        layers = {"payload": 0.5, "mavlink": 0.1, "udp": 0.1, "ip": 0.2, "ethernet": 0.1}
    share = {"packets": PACKETS[protocol] // 18, "bytes": SIZES[protocol] // 18, "lost": 0}
    words = [{"command": c, "word": "completed", "reason": None, "after_ms": ms} for c, ms in _AFTER_MS.items()]
    commands, states = (6, 225) if protocol == "mqttxt" else (18, 65_000)
    return {
        **NOT_FLOWN,
        "attempt": number,
        "repeat": 0,
        "status": "completed",
        "reason": None,
        "window": {"start_ns": T0, "seconds": MISSION_S[protocol]},
        "mission_s": MISSION_S[protocol],
        "size_bytes": SIZES[protocol],
        "packets": PACKETS[protocol],
        "message_loss": {"commands": 0.0, "states": 0.0},
        "commands_sent": commands,
        "states_sent": states,
        "messages": messages(commands, states),
        "wire_loss": 0.0,
        "delay_ms": {"arm": [1.0, 2.0, 3.0], "takeoff": [2.0, 3.0, 4.0], "land": [3.0, 4.0, 50.0]},
        "outcomes": {str(drone): words for drone in DRONES},
        "layers": {name: round(part * SIZES[protocol]) for name, part in layers.items()},
        "mqtt": {},
        "links": {f"{name}:{way}": share for name in LINKS for way in ("up", "down")},
        "before_mission": {"packets": 400, "bytes": 45_000},
        "foreign": {"arp": 17},
        "truncated": [],
        "frames_per_call": {"arm": 1.0, "takeoff": 1.0 if protocol == "mqttxt" else 2.5, "land": 1.0},
        "cpu_s": CPU[protocol],
        "memory_bytes": {},
        "links_measured": {},
        "notes": [],
        "mavlink": mavlink() if protocol == "mavlink" else None,
    } | changed


def messages(commands: int, states: int, *, states_lost: int = 0) -> dict[str, Any]:
    """The counts of `commands` and `states`, all of one kind each; `states_lost` of the states were lost."""
    return {"commands": {"arm": _counted(commands, 0)}, "states": {"battery": _counted(states, states_lost)}}


def _counted(sent: int, lost: int) -> dict[str, Any]:
    return {**loss_of(sent, lost), "open": 0, "drones": {"1": {"sent": sent, "lost": lost, "open": 0}}}


LINKS = ("wan:gs", "backhaul:fog1", "backhaul:fog2", *(f"air:uav{drone}" for drone in DRONES))


def rich_entry(protocol: str, number: int = 1, **changed: Any) -> dict[str, Any]:
    """An attempt over shaped links, with everything that `metrics.json` can have."""
    slow = 2.0 if protocol == "mavlink" else 1.0
    lost = dict.fromkeys(("overload", "corrupted", "unknown", "captured"), 0)
    lost |= {"random": 4, "queue": 20 if protocol == "mavlink" else 0, "closed": 1}
    figures = {
        "delay_ms": {"configured": 25.0, "measured": 25.2},
        "rate_bps": {"configured": 1_450_000, "measured": 1_448_000},
        "loss": {"configured": 0.01, "measured": 0.011},
    }
    ways = [f"{name}:{way}" for name in LINKS for way in ("up", "down")]
    several = {name: {"bytes": SIZES[protocol] // 4, "packets": PACKETS[protocol] // 4} for name in PURPOSES}
    summary = {"n": 1200, "mean": 30.0 * slow, "p50": 28.0 * slow, "p90": 44.0 * slow, "p99": 90.0 * slow, "max": 91.0}
    seconds = round(MISSION_S[protocol])
    return (
        entry(protocol, number)
        | {
            "mission_s": MISSION_S[protocol] + number / 10,
            "delay_ms": {name: [30.0 * slow + n + number for n in range(6)] for name in ("arm", "takeoff", "land")},
            "delay_app_ms": {name: [40.0 * slow + n for n in range(6)] for name in ("arm", "takeoff", "land")},
            "state_delay_ms": {"battery": {"captures": summary, "app": None if slow > 1 else summary}},
            "message_sizes": {"arm": {"n": 6, "mean": 86.0, "min": 86, "max": 90, "share": 86.0, "ack_bytes": 66.0}},
            "size_histogram": {"40-79": PACKETS[protocol] // 2, "80-159": PACKETS[protocol] // 3, "1280-2559": 2},
            "purposes": several,
            "load": {"fog1": {"uav1": [900] * seconds}, "fog2": {"uav4": [0] * seconds}, "total": [900] * seconds},
            "losses": {**lost, "links": {name: lost for name in ways if name.startswith("air")}},
            "links_measured": dict.fromkeys(ways, figures),
            "memory_bytes": dict.fromkeys(CPU[protocol], 40000000),
            "notes": ["air:uav1:up: the shaper counts 25 frames lost, the captures 24"],
        }
        | changed
    )


PURPOSES = ("command", "result", "state", "acknowledgement")


def mavlink(dropped: int = 3) -> dict[str, Any]:
    """The MAVLink side's own numbers."""
    streams = []
    for name, (rate_hz, size) in STREAMS.items():
        count = round(rate_hz * MISSION_S["mavlink"] * len(DRONES))
        streams.append({"name": name, "count": count, "rate_hz": rate_hz, "bytes": count * size, "mean_size": size})
    nodes = ["fog2", "fog1", "cloud"]
    routers = [{"node": n, "way": way, "in": 1000, "out": 1000, "dropped": 0} for n in nodes for way in ("up", "down")]
    routers[2] |= {"out": 1000 - dropped, "dropped": dropped}  # fog1 up
    return {
        "streams": streams,
        "commands": [
            {"name": "COMMAND_LONG 400", "count": 6, "bytes": 498},
            {"name": "HEARTBEAT", "count": 360, "bytes": 22_680},
        ],
        "routers": routers,
        "own_heartbeats": 1234,
    }


def failed(protocol: str, reason: str, number: int = 1, **changed: Any) -> dict[str, Any]:
    """A failed attempt with its counts until it gave up."""
    return entry(protocol, number, status="failed", reason=reason, mission_s=None, packets=20_000, **changed)


def make_series(series: Series, *entries: tuple[str, dict[str, Any]], **changed: Any) -> dict[str, Any]:
    """Make folders for attempts given as (protocol, entry), and the series' metrics; void attempts are listed apart."""
    protocols: dict[str, Any] = {}
    for protocol, one in entries:
        _write_attempt(series, protocol, one)
        side = protocols.setdefault(protocol, {"attempts": [], "void": []})
        if one["status"] == "void":
            side["void"].append({"attempt": one["attempt"], "reason": one["reason"]})
        else:
            side["attempts"].append(one)
    return write_metrics(series, protocols, **changed)


def write_metrics(series: Series, protocols: dict[str, Any], **changed: Any) -> dict[str, Any]:
    """Write and return the metrics of attempts that were counted, with what follows from them."""
    metrics = {
        "version": METRICS_VERSION,
        "experiment": "scenario-1",
        "arm": "thesis",
        "profile": "ideal",
        "revision": "c0ffee",
        "shaper": "none",
        "protocols": dict(sorted(protocols.items())),
        "ratios": ratios(observe(protocols)),
        "statistics": statistics(observe(protocols)),
        "notes": [],
    } | changed
    assert schema_error(metrics) is None
    write_json(series.path / METRICS, metrics)
    return metrics


_AFTER_MS = {"arm": 14.0, "takeoff": 7100.0, "land": 14300.0}


def _write_attempt(series: Series, protocol: str, one: dict[str, Any]) -> Attempt:
    attempt = new_attempt(series, protocol, one["attempt"])
    told = {"status": one["status"], "reason": one["reason"], "configuration": FACTORS, "protocol": protocol}
    write_json(attempt.path / "manifest.json", manifest(**told))
    (attempt.path / "logs" / "gs.log").write_text("")
    write_lines(attempt.path / "events.jsonl", _events(protocol, one))
    for index, drone in enumerate(DRONES):
        write_lines(attempt.path / "sitl" / f"uav{drone}.jsonl", _flight(protocol, index))
    if not _WITHOUT_CAPTURES:
        _WITHOUT_CAPTURES.append(table.build(attempt))
    table._write(attempt.path, _WITHOUT_CAPTURES[0], table._sources(attempt))
    return attempt


_WITHOUT_CAPTURES: list[table.Built] = []
"""The packets table of a measured attempt: without captures it is the same for all."""


def _events(protocol: str, one: dict[str, Any]) -> list[dict[str, Any]]:
    """One call per command and drone over MAVLink, or fog over MQTT-XT; a failed mission gives up in takeoff."""
    ok = one["status"] != "failed"
    scale = MISSION_S[protocol] / MISSION_S["mqttxt"]
    begun = {"arm": 0.0, "takeoff": 0.1 * scale, "hold": 7.1 * scale, "land": 22.1 * scale, "end": MISSION_S[protocol]}
    events = [{"t_ns": T0 - 1000, "event": "mission_start", "scenario": "scenario-1", "drones": list(DRONES)}]
    call = 0
    names = list(begun) if ok else ["arm", "takeoff", "hold"]
    for name, following in pairwise(names):
        start, until = (T0 + int(begun[at] * SECOND) for at in (name, following))
        events.append({"t_ns": start, "event": "step", "name": name, "limit_s": 90})
        for target in DRONES if protocol == "mavlink" else (1, 2):
            if name == "hold":
                break
            call += 1
            whom = {"drone": target} if protocol == "mavlink" else {"fog": target, "drone": None}
            events.append({"t_ns": start, "event": "command", "call": call, "command": name, "fog": None, **whom})
        done = ok or name == "arm"
        for drone in DRONES if name != "hold" else ():
            told = {"word": "completed" if done else "denied", "reason": None if done else "not healthy"}
            at = {"t_ns": until - drone * SECOND // 20, "event": "outcome", "call": call, "command": name}
            events.append({**at, "fog": None, "drone": drone, "id": f"7:{call}", **told, "final": True})
        events.append({"t_ns": until, "event": "step_done", "name": name, "ok": done, "reason": None})
    last_ns = events[-1]["t_ns"]
    events.append({"t_ns": last_ns, "event": "mission_end", "status": one["status"], "reason": one["reason"]})
    return events


def _flight(protocol: str, index: int) -> list[dict[str, Any]]:
    """Up to 10 m, hold, and down; over MAVLink each drone a little after the one before."""
    scale = MISSION_S[protocol] / MISSION_S["mqttxt"]
    late_s = 2.0 * index if protocol == "mavlink" else 0.0
    shape = [(0.0, 0.0), (7.0, 10.0), (22.0, 10.0), (34.0, 0.0)]
    log: list[dict[str, Any]] = [
        {"t_ns": T0 + int((t * scale + late_s) * SECOND), "event": "position", "altitude_m": height}
        for t, height in shape
    ]
    return [*log, {"t_ns": T0 + int(MISSION_S[protocol] * SECOND), "event": "disarmed"}]

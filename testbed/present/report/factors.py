"""How each side was flown, in words, and what that means for the comparison."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from ...plan import wording
from ...plan.experiments import ARMS
from ...plan.factors import FACTORS, MEANINGS
from . import thesis

_BROADCAST = "a command for all drones is one broadcast a fog"


_STREAMS_BESIDE = (
    "Beside each kind MAVLink goes on streaming PX4's whole set. The state asked about comes at its rate, of which "
    "the program takes the newest value once per second; MQTT-XT's drone publishes it once per second. So all "
    "frames together compare two ways of working, and a kind's own frames compare what each sends for it."
)
_MESSAGES_BESIDE = (
    "Both sides send the state asked about once per second and are kept from sending the others, so what goes beside a "
    "kind is what each protocol cannot do without."
)


_SECURED = "SECURITY is MQTT-XT's alone: MAVLink flies as without it, neither encrypted nor signed."


@dataclass(frozen=True)
class Factor:
    """A factor of one side: its name, its value, and its meaning in words."""

    name: str
    value: str
    words: str


def factors_of(configuration: dict[str, Any], protocol: str, one_drone: bool = False) -> list[Factor]:
    """The factors of a side that the manifest has; an unknown value is shown as it is.

    `one_drone` leaves out how several drones are commanded.
    """
    said = []
    for name, values in MEANINGS.get(protocol, {}).items():
        if name not in configuration or (one_drone and name == "commanding"):
            continue
        value = _value(configuration, name)
        said.append(Factor(name, value, values.get(value, value)))
    if protocol == "mqttxt" and said and not one_drone and _value(configuration, "station") != "mavsdk":
        said.append(Factor("commanding", "broadcast", _BROADCAST))
    return said


def fairness(configuration: dict[str, Any], one_drone: bool = False) -> list[str]:
    """Sentences on what the factors mean for the comparison; factors that the manifest lacks are left out.

    `one_drone`: the experiment is the message set.
    """
    said = []
    streams, states = _value(configuration, "streams"), _value(configuration, "states")
    if one_drone and streams and states:
        said.append(_MESSAGES_BESIDE if streams == "five-states" else _STREAMS_BESIDE)
    elif streams == "five-states" and states in ("fixed", "bundle"):
        waits = " MQTT-XT's wait up to a second for their bundle, MAVLink's leave at once."
        said.append(
            "Both sides carry the same five states once a second: packets and bytes compare the same content."
            + (waits if states == "bundle" else "")
        )
    elif streams and states:
        said.append(
            "The sides do not carry the same content: MAVLink brings whole streams at set rates, MQTT-XT what its "
            "drones tell. Packets and bytes compare two ways of working; the arm five-states compares the same content."
        )
    commanding = _value(configuration, "commanding") if not one_drone else ""
    if commanding == "one-by-one":
        said.append(
            "MAVLink's drones are commanded one after the other, MQTT-XT's together: what asking one by one takes is "
            "in the mission time, and is not the protocol's. COMMANDING=concurrent takes it away."
        )
    elif commanding == "concurrent":
        said.append("Both sides command all drones at once, so their mission times compare directly.")
    chain = _value(configuration, "chain")
    if chain == "direct":
        said.append("Nothing forwards, adds or drops messages on the way: beside a chain it shows what routers cost.")
    elif chain == "shared":
        said.append(
            "A shared router sends telemetry down to every other drone as well; that, and the routers' own heartbeats, "
            "are among MAVLink's packets and bytes."
        )
    elif chain:
        said.append(
            "The routers' own heartbeats are among MAVLink's packets and bytes, as MQTT's upkeep is among the other's."
        )
    if _value(configuration, "qos") == "0":
        said.append("QoS 0 spares MQTT-XT the acknowledgements of MQTT; those of TCP are counted.")
    if _value(configuration, "security") in ("tls", "signed"):
        said.append(_SECURED)
    for name, instead in (("AUTOPILOT", "the stand-in's place"), ("ROUTER", "the place of mavp2p as it is built here")):
        if configuration.get(name):
            said.append(f"Flown with {name}={configuration[name]} in {instead}.")
    if "fogs" in configuration and not one_drone:
        size = (configuration["fogs"], configuration["drones"])
        without = (
            "" if size == thesis.FLEET else f" The thesis's figures, of {wording.fleet(*thesis.FLEET)}, are left out."
        )
        said.append(f"Another fleet than the thesis's flew: {wording.fleet(*size)}.{without}")
    return said


def deviations(configuration: dict[str, Any], arm: str) -> list[tuple[str, str]]:
    """Factors that deviate from the arm's own, as (qos, 1); none for an arm that no longer exists."""
    if arm not in ARMS:
        return []
    own = {name: str(value) for name, value in asdict(ARMS[arm].factors).items()}
    flown = {name: _value(configuration, name) for name in own if name in configuration}
    return [(name, value) for name, value in flown.items() if value != own[name]]


def mixed(manifests: list[dict[str, Any]]) -> list[str]:
    """A sentence for each condition in which the attempts of one series differ although they should not."""
    said = []
    revisions = {str(manifest["revision"].get("commit")) for manifest in manifests}
    if len(revisions) > 1:
        said.append(
            f"The attempts were flown at {len(revisions)} different revisions; each one's is among its conditions."
        )
    for name in FACTORS:
        values = {
            _value(manifest["configuration"], name) for manifest in manifests if name in manifest["configuration"]
        }
        if len(values) > 1:
            said.append(f"The attempts were not all flown alike: {name} was {wording.listed(sorted(values))}.")
    for name in ("profile", "arm", "shaper"):
        values = {str(manifest.get(name)) for manifest in manifests}
        if len(values) > 1:
            said.append(f"The attempts were not all flown alike: {name} was {wording.listed(sorted(values))}.")
    return said


def _value(configuration: dict[str, Any], name: str) -> str:
    return str(configuration.get(name, ""))

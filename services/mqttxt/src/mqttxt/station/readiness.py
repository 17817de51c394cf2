"""What a station still lacks: of a fog, to send it commands; of the cloud broker, the revocation list."""

from __future__ import annotations

from ..errors import FogUnreachable
from .fog import LINK, FogView
from .process import StationRunner, check_timeout


def signs_otherwise(runner: StationRunner, view: FogView) -> bool:
    """Whether a fog's activator signs messages and this station does not, or the reverse."""
    return view.subscribed and not view.up and view.is_signed not in (None, runner.station.signs)


def missing(runner: StationRunner, view: FogView) -> str:
    """Why commands cannot be sent to a fog yet, for an error."""
    link, station = runner.links[LINK], runner.station
    if not station.connected:
        return f"no connection to {link.address}{f' ({link.failure})' if link.failure else ''}"
    if not view.subscribed:
        return f"{link.address} has not granted the subscription"
    if signs_otherwise(runner, view):
        return f"its activator {'signs' if view.is_signed else 'does not sign'} messages and this station " + (
            "does not; expected `signed` beside `identity`" if view.is_signed else "does; expected no `signed`"
        )
    if not view.up:
        return f"no activator is at {link.address}"
    if view.registered and station.signs:
        return "no signed beacon of a drone that is reachable has come"
    return "its activator has not confirmed the registration"


async def share_list(runner: StationRunner, timeout_s: float) -> int:
    """Wait until the cloud broker has this station's revocation list or a newer one; returns the list's number.

    Raises FogUnreachable where the broker does not show it in time.
    """
    check_timeout(timeout_s)
    assert runner.identity is not None
    link, station = runner.links[LINK], runner.station
    try:
        await runner.wait_until(lambda: station.connected and runner.lists.is_shown(LINK), timeout_s)
    except TimeoutError:
        failure = f" ({link.failure})" if link.failure else ""
        lacks = "does not show the revocation list: is its access list new enough (`mqttxt broker`)?"
        raise FogUnreachable(
            f"{link.address}: {lacks if station.connected else f'no connection{failure}'} (waited {timeout_s:g} s)"
        ) from None
    return runner.identity.fleet.revoked.number

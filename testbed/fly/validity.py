"""Whether the numbers of an attempt can stand: every capture whole, every event there that they are made from."""

from __future__ import annotations

from typing import Any

from .results import Attempt


def void_reason(captures: list[dict[str, Any]], nodes: list[str]) -> str | None:
    """Why a completed attempt proves nothing: a capture is missing, or dropped packets; None when it is sound."""
    missing = sorted(set(nodes) - {capture["node"] for capture in captures})
    if missing:
        return f"no capture at {', '.join(missing)}"
    dropped = [f"{c['node']} {'?' if c['dropped'] is None else c['dropped']}" for c in captures if c["dropped"] != 0]
    return f"captures dropped packets: {', '.join(dropped)}" if dropped else None


def unsound_reason(attempt: Attempt, manifest: dict[str, Any], events: list[dict[str, Any]]) -> str | None:
    """What is missing for the numbers of a completed attempt; None when everything is there.

    A failed attempt is never void: it stays in the table with what there is.
    """
    nodes = [node["name"] for node in manifest["topology"]["nodes"]]
    captured = [c for c in attempt.captures() if (attempt.path / "pcap" / f"{c['node']}.pcap").exists()]
    reason = void_reason(captured, nodes)
    if reason is not None:
        return reason
    if not any(event["event"] == "mission_end" for event in events):
        return "events.jsonl does not have the mission's end"
    logs = attempt.autopilot_events()
    flown = [f"uav{drone}" for event in events if event["event"] == "mission_start" for drone in event["drones"]]
    silent = [node for node in flown if not any(event["event"] == "disarmed" for event in logs.get(node, []))]
    return f"no autopilot's own word of disarming: {', '.join(silent)}" if silent else None


def common_revision(manifests: list[dict[str, Any]]) -> str | None:
    """The commit at which every attempt was flown; None where there is not one."""
    commits = {manifest["revision"].get("commit") for manifest in manifests}
    return commits.pop() if len(commits) == 1 else None


def with_failure(reason: str, status: str, failure: str | None) -> str:
    """Why an attempt is void; where it had failed as well, that too."""
    return f"{reason}; this one had failed: {failure}" if status == "failed" else reason

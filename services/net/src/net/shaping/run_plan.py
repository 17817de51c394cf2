"""`plan.json` in a run's folder `links`: the plan, the shaper to use, the kernel's commands, and gates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..emulator.plan import ShapedPlan, is_number, mapping, parse_plan, read_json, wrong
from ..link_plan import DIRECTIONS, RUN_VERSION, SHAPERS, Gate

FIELDS = ("version", "shaper", "always", "plan", "kernel", "gates")


@dataclass(frozen=True)
class RunPlan:
    """The content of `plan.json`; `kernel` is not parsed yet, as only `KernelLinks` needs it."""

    shaper: str
    always: bool
    plan: ShapedPlan
    kernel: Mapping[str, Any]
    gates: tuple[Gate, ...]

    @property
    def is_shaped(self) -> bool:
        """Whether anything is done to any frame in the run."""
        shaped = any(link.is_shaped for link in self.plan.links.values())
        return self.always or bool(self.gates) or bool(self.plan.events) or shaped


def read_run_plan(path: Path) -> RunPlan:
    """Read `plan.json`. Raises PlanError that names file, field, value and what was expected."""
    top = mapping(read_json(path), str(path), FIELDS)
    if top.get("version") != RUN_VERSION:
        raise wrong(f"{path}: version", top.get("version"), f"{RUN_VERSION}")
    if top.get("shaper") not in SHAPERS:
        raise wrong(f"{path}: shaper", top.get("shaper"), f"one of {', '.join(SHAPERS)}")
    always = top.get("always", False)
    if not isinstance(always, bool):
        raise wrong(f"{path}: always", always, "true or false")
    plan = parse_plan(top.get("plan"), f"{path}: plan")
    gates = top.get("gates", [])
    if not isinstance(gates, list):
        raise wrong(f"{path}: gates", gates, "a list")
    found = tuple(_gate(gate, plan, f"{path}: gates[{number}]") for number, gate in enumerate(gates))
    return RunPlan(top["shaper"], always, plan, mapping(top.get("kernel", {}), f"{path}: kernel", None), found)


def _gate(value: object, plan: ShapedPlan, where: str) -> Gate:
    given = mapping(value, where, ("link", "drone", "latitude_deg", "longitude_deg", "range_m"))
    link = given.get("link")
    if not isinstance(link, str) or not {f"{link}:{direction}" for direction in DIRECTIONS} <= set(plan.links):
        raise wrong(f"{where}.link", link, "a link of the plan, without its direction")
    drone = given.get("drone")
    if not isinstance(drone, int) or isinstance(drone, bool) or not 1 <= drone <= 250:
        raise wrong(f"{where}.drone", drone, "a drone's number")
    for name, low, high in (("latitude_deg", -90, 90), ("longitude_deg", -180, 180), ("range_m", 0, 1_000_000)):
        number = given.get(name)
        if not is_number(number) or not low <= number <= high:
            raise wrong(f"{where}.{name}", number, f"a number from {low} to {high}")
    return Gate(link, drone, *(float(given[name]) for name in ("latitude_deg", "longitude_deg", "range_m")))

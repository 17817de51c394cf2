"""A UAV client that publishes the five vital states once per second, changed or not: `steady_uav DRONE BROKER …`."""

from __future__ import annotations

import sys
from pathlib import Path

from mqttxt.cli.common import run_role, settings
from mqttxt.core.address import BrokerAddress
from mqttxt.drone.journal import JournalFile
from mqttxt.drone.mavlink.transports import AutopilotAddress
from mqttxt.drone.process import UavRunner
from mqttxt.protocol.policies import Policy
from tests.bench.fleet import FIVE

STEADY = Policy(lambda _old, _new: True, min_interval_ms=1000)


def main(drone: str, broker: str, autopilot_port: str, folder: str, form: str) -> None:
    base = Path(folder) / f"uav{drone}"

    def make() -> UavRunner:
        return UavRunner(
            int(drone),
            BrokerAddress.parse(broker),
            AutopilotAddress("udp", "127.0.0.1", int(autopilot_port)),
            JournalFile(base.with_suffix(".journal"), with_front=True),
            settings(1, json=False, bundles=form == "bundles"),
            ready_file=base.with_suffix(".ready"),
            policies={state.name: STEADY for state in FIVE},
        )

    run_role(make)


if __name__ == "__main__":
    main(*sys.argv[1:])

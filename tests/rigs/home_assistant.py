"""A real Home Assistant with nothing but MQTT: run by a Python that has it, it prints the states of its entities.

`PYTHON home_assistant.py FOLDER PORT`: entities' ids, states and units as JSON, a line whenever they change.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from pathlib import Path


async def run(folder: Path, port: int) -> None:
    from homeassistant import bootstrap, runner  # type: ignore[import-not-found, unused-ignore]

    entry = {
        **{"entry_id": "1" * 32, "version": 1, "minor_version": 1, "domain": "mqtt", "title": "broker"},
        **{"data": {"broker": "127.0.0.1", "port": port, "discovery": True}, "options": {}, "unique_id": None},
        **{"source": "user", "disabled_by": None, "pref_disable_new_entities": False, "pref_disable_polling": False},
    }
    storage = folder / ".storage"
    storage.mkdir(parents=True, exist_ok=True)
    kept = {"version": 1, "minor_version": 1, "key": "core.config_entries", "data": {"entries": [entry]}}
    (storage / "core.config_entries").write_text(json.dumps(kept))
    (folder / "configuration.yaml").write_text("homeassistant:\n  name: test\n")
    hass = await bootstrap.async_setup_hass(
        runner.RuntimeConfig(config_dir=str(folder), skip_pip=True, recovery_mode=False)
    )
    await hass.async_start()
    before = None
    while True:
        states = {
            state.entity_id: [state.state, state.attributes.get("unit_of_measurement")]
            for state in hass.states.async_all()
        }
        if states != before:
            print(json.dumps({"at": time.time(), "states": states}), flush=True)
            before = states
        await asyncio.sleep(0.2)


if __name__ == "__main__":
    asyncio.run(run(Path(sys.argv[1]), int(sys.argv[2])))

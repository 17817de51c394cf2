"""The real Prometheus shows the fleet, where it is on the PATH."""

from __future__ import annotations

import json
import shutil
import subprocess
import urllib.parse
import urllib.request
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.rigs.gateway import Ground
from tests.rigs.processes import Process, free_port, wait_until
from tests.unit.mqttxt.test_metrics import DASHBOARD

PROMETHEUS = shutil.which("prometheus")
ALERT_PAGE = Path(__file__).resolve().parents[2] / "docs" / "metrics.md"
pytestmark = [pytest.mark.integration, pytest.mark.apart]


@pytest.fixture
def shown(ground: Ground) -> Iterator[int]:
    """`mqttxt gs metrics` at the port."""
    port = free_port()
    where = ["--fog", "1", "--cloud", ground.cloud.url, "--listen", f"127.0.0.1:{port}"]
    metrics = Process(ground.folder, "metrics", "mqttxt", "gs", "metrics", *where).start()
    try:
        yield port
    finally:
        metrics.kill()


def block(page: Path, begins: str) -> str:
    """The block of a page's examples that begins so."""
    blocks = page.read_text(encoding="utf-8").split("```")
    return next(found.partition("\n")[2] for found in blocks if found.partition("\n")[2].startswith(begins))


@pytest.mark.skipif(PROMETHEUS is None, reason="no prometheus on the PATH")
def test_prometheus_scrapes_what_the_page_says_and_has_what_the_dashboard_asks(
    ground: Ground, shown: int, tmp_path: Path
) -> None:
    assert PROMETHEUS is not None
    port, folder = free_port(), tmp_path / "prometheus"
    folder.mkdir()
    alert = "".join(f"      {line}\n" for line in block(ALERT_PAGE, "- alert").splitlines())
    (folder / "rules.yaml").write_text(f"groups:\n  - name: fleet\n    rules:\n{alert}")
    configuration = block(ALERT_PAGE, "scrape_configs").replace("9464", str(shown)).replace("5s", "1s")
    (folder / "prometheus.yml").write_text(
        configuration + "rule_files: [rules.yaml]\nglobal: {evaluation_interval: 1s}\n"
    )
    where = [f"--web.listen-address=127.0.0.1:{port}", f"--storage.tsdb.path={folder}/data"]
    command = [PROMETHEUS, f"--config.file={folder}/prometheus.yml", *where]

    def query(expression: str) -> list[Any]:
        asked = f"http://127.0.0.1:{port}/api/v1/query?{urllib.parse.urlencode({'query': expression})}"
        try:
            with urllib.request.urlopen(asked, timeout=10) as answer:
                return list(json.load(answer)["data"]["result"])
        except OSError:
            return []

    with (folder / "log").open("wb") as log, subprocess.Popen(command, stdout=log, stderr=log) as running:
        try:
            wait_until(lambda: len(query("mqttxt_drone_reachable == 1")) == 2, "both drones are shown")
            dashboard: dict[str, Any] = json.loads(DASHBOARD.read_text(encoding="utf-8"))
            asked = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
            for expression in asked:
                chosen = expression.replace("$fog", ".*").replace("$drone", ".*")
                if "sensor_reading" not in chosen:
                    wait_until(partial(query, chosen), chosen)
            assert query('ALERTS{alertname="DroneSilent"}') == []
        finally:
            running.terminate()

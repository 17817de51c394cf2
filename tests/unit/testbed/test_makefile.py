"""What `make` types: every variable reaches the testbed as it was given."""

from __future__ import annotations

import os
import shlex
import subprocess
from itertools import pairwise

import pytest

from testbed.plan.documents import ROOT
from testbed.plan.factors import FACTORS


def _typed(*words: str, **environment: str) -> dict[str, str]:
    """The options of the last command that make would run, by their names."""
    return {word: after for word, after in pairwise(_words(*words, **environment)) if word.startswith("--")}


def _words(*words: str, **environment: str) -> list[str]:
    kept = {"PATH": os.environ["PATH"], **environment}
    done = subprocess.run(["make", "--dry-run", *words], cwd=ROOT, env=kept, capture_output=True, text=True, check=True)
    return shlex.split(done.stdout.splitlines()[-1])


def test_an_experiment_flies_both_and_leaves_the_factors_to_the_arm() -> None:
    options = _typed("scenario-1")
    assert options["--protocols"] == "mqttxt,mavlink"
    assert {options[f"--{name}"] for name in FACTORS} == {""}


@pytest.mark.parametrize("name", FACTORS)
@pytest.mark.parametrize("target", ["scenario-1", "up"])
def test_each_factor_is_a_variable(target: str, name: str) -> None:
    value = FACTORS[name][-1]
    assert _typed(target, f"{name.upper()}={value}")[f"--{name}"] == value
    assert _typed(target, **{name.upper(): value})[f"--{name}"] == value


def test_flights_are_shown_on_the_page_only_where_somebody_says_so() -> None:
    assert "--page" not in _words("scenario-1")
    assert "--page" in _words("scenario-1", "PAGE=1")
    assert "--page" in _words("scenario-1", PAGE="1")


def test_one_fleet_is_up_at_a_time_and_it_is_mqttxt_unless_somebody_says_otherwise() -> None:
    assert _typed("up")["--protocol"] == "mqttxt"
    assert _typed("up", "PROTOCOLS=mavlink")["--protocol"] == "mavlink"
    assert _typed("up", PROTOCOLS="mavlink")["--protocol"] == "mavlink"
    assert _typed("up", "PROTOCOLS=mqttxt,mavlink")["--protocol"] == "mqttxt,mavlink"


def test_the_links_of_all_profiles_are_probed_unless_somebody_names_some() -> None:
    assert _typed("links")["--profile"] == ""
    assert _typed("links", "PROFILE=lte,sik")["--profile"] == "lte,sik"
    assert _typed("links", PROFILE="lte")["--profile"] == "lte"


def test_everything_is_flown_unless_somebody_names_some() -> None:
    options = _typed("all")
    assert [options[name] for name in ("--experiments", "--arms", "--profiles")] == ["", "", ""]
    assert options["--attempts"] == "1"
    assert options["--scheduler"] == ""
    assert _typed("all", "ARMS=thesis,direct")["--arms"] == "thesis,direct"
    assert _typed("all", "EXPERIMENTS=scenario-3", "ATTEMPTS=2")["--experiments"] == "scenario-3"


def test_the_headline_is_flown_as_its_table_says_unless_somebody_says_otherwise() -> None:
    options = _typed("reproduce")
    assert (options["--attempts"], options["--seed"]) == ("", "")
    options = _typed("reproduce", "ATTEMPTS=9", "SEED=1")
    assert (options["--attempts"], options["--seed"]) == ("9", "1")
    assert _typed("reproduce", ATTEMPTS="9")["--attempts"] == "9"


def test_a_campaign_on_many_machines_has_a_scheduler_and_a_certificate() -> None:
    address = "tls://lab:8786"
    for target in ("all", "worker"):
        options = _typed(target, f"SCHEDULER={address}", "CERTIFICATE=other.pem")
        assert (options["--scheduler"], options["--certificate"]) == (address, "other.pem")
    assert _typed("scheduler", "PORT=9000")["--port"] == "9000"
    assert _words("certificate")[-1] == "campaign.pem"

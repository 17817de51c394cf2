"""The thesis's figures: in our units, whole, and with what to know about them."""

from __future__ import annotations

import pytest

from testbed.report import thesis


def test_a_scenario_is_in_our_units() -> None:
    assert thesis.of_scenario("scenario-1") == {
        "size_bytes": {"mavlink": 50_687_820.7, "mqttxt": 509_256},
        "packets": {"mavlink": 512_827, "mqttxt": 7_716},
        "mission_s": {"mavlink": 64, "mqttxt": 44},
        "wire_loss": {"mavlink": 0.28, "mqttxt": 0.01},
    }


@pytest.mark.parametrize("experiment", thesis.scenarios())
def test_each_scenario_has_its_caveats(experiment: str) -> None:
    said = thesis.caveats(experiment)
    assert any("means" in text for text in said)
    assert ("a slip" in " ".join(said)) == (experiment == "scenario-4")


def test_what_it_never_flew_has_no_figures() -> None:
    assert thesis.of_scenario("scenario-9") == {}
    assert thesis.caveats("scenario-9") == ()


@pytest.mark.parametrize(("experiment", "ratio"), [("scenario-1", 66), ("scenario-2", 22), ("scenario-3", 129)])
def test_the_ratios_that_the_caveats_name_follow_from_the_figures(experiment: str, ratio: int) -> None:
    packets = thesis.of_scenario(experiment)["packets"]
    assert round(packets["mavlink"] / packets["mqttxt"]) == ratio


def test_its_mqttxt_bytes_are_the_size_of_an_empty_acknowledgement() -> None:
    for experiment in ("scenario-1", "scenario-2", "scenario-3"):
        figures = thesis.of_scenario(experiment)
        assert figures["size_bytes"]["mqttxt"] / figures["packets"]["mqttxt"] == pytest.approx(66.0)


def test_every_caveat_is_shown_somewhere() -> None:
    known = {"scenarios", "message_set", "packet_size", "claims", *thesis.scenarios()}
    for caveat in thesis.everything()["caveats"]:
        assert set(caveat["about"]) <= known, caveat["id"]

"""The thesis's figures: in our units, whole, and with what to know about them."""

from __future__ import annotations

import pytest

from testbed.present.report import thesis


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


def test_a_kind_of_message_is_in_our_units_for_one_message() -> None:
    assert thesis.of_kind("takeoff") == {
        "packets": {"mavlink": 245.85, "mqttxt": 50.66},
        "bytes": {"mavlink": pytest.approx(23_247.576), "mqttxt": pytest.approx(3_444.88)},
        "delay_ms": {"mavlink": 820.0, "mqttxt": 762.0},
        "loss": {"mavlink": 0.01, "mqttxt": 0.0},
    }
    assert thesis.of_kind("hold") == {}


def test_the_ratios_of_the_message_set_that_a_caveat_names_follow_from_the_figures() -> None:
    kinds = {name: thesis.of_kind(name)["packets"] for name in thesis.everything()["message_set"]}
    ratios = {name: packets["mavlink"] / packets["mqttxt"] for name, packets in kinds.items()}
    commands = [ratios[name] for name in ("arm", "takeoff", "land", "offboard", "goto")]
    states = [ratios[name] for name in ("battery", "location", "groundspeed", "flight_mode", "heading")]
    said = " ".join(thesis.caveats("messages"))
    assert f"{min(commands):.1f} to {max(commands):.1f} for its commands" in said
    assert f"{min(states):.1f} to {max(states):.1f} for its states" in said


def test_bytes_that_are_packets_times_a_constant_are_known() -> None:
    computed = {name for name in thesis.everything()["message_set"] if thesis.bytes_were_computed(name)}
    assert computed == {"arm", "takeoff", "land", "offboard", "goto", "location", "groundspeed", "heading"}


def test_its_commands_have_too_few_packets_for_their_delays() -> None:
    kinds = {name: thesis.of_kind(name) for name in thesis.everything()["message_set"]}
    commands = ("arm", "takeoff", "land", "offboard", "goto")
    a_second = [by["packets"]["mavlink"] for name, by in kinds.items() if name not in commands]  # one value a second
    packets = [kinds[name]["packets"]["mavlink"] for name in commands]
    delays = [kinds[name]["delay_ms"]["mavlink"] for name in commands]
    said = " ".join(thesis.caveats("messages"))
    assert f"{min(a_second):,.0f} to {max(a_second):,.0f} packets a second" in said
    assert f"{min(packets) / max(a_second):.2f} to {max(packets) / min(a_second):.2f} s of streaming" in said
    assert f"{min(delays):.0f} to {max(delays):.0f} ms" in said

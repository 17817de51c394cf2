"""A plan's commands for a kernel with netem: two stages, each link for itself."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from testbed.cli import commands as cli
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.directed import directed_links
from testbed.plan.profiles.kernel import Commands, Words, beyond, change_words, commands_of
from testbed.plan.profiles.reading import FOLDER, profile_names, read_profile
from testbed.plan.profiles.resolve import LinksPlan, resolve

TOPOLOGY = standard_fleet().topology()

AIR = "{air: {both: {delay: 40ms, source: s}}}"


def _plan(folder: Path, links: str, events: str = "[]") -> LinksPlan:
    path = folder / "own.yaml"
    path.write_text(f"description: own\nlinks: {links}\nevents: {events}")
    return resolve(read_profile(str(path)), TOPOLOGY, "scenario-1", 1, 60)


def _commands(folder: Path, links: str, events: str = "[]") -> Commands:
    return commands_of(_plan(folder, links, events), TOPOLOGY)


def _about(commands: Commands, *parts: str) -> list[str]:
    lines = [" ".join(words) for words in commands.begin]
    return [line for line in lines if all(part in line for part in parts)]


def test_an_unshaped_link_meets_no_command(tmp_path: Path) -> None:
    assert _commands(tmp_path, "{}") == Commands((), (), ())
    said = str(_commands(tmp_path, AIR))
    assert "air-uav1-up" in said
    assert "wan" not in said


def test_a_destination_tells_the_link_that_a_frame_takes_from_a_node() -> None:
    assert beyond(TOPOLOGY, "fog1", "cloud") == ["gs", "cloud", "fog2", "uav4", "uav5", "uav6"]
    assert beyond(TOPOLOGY, "fog1", "uav2") == ["uav2"]
    assert beyond(TOPOLOGY, "cloud", "fog2") == ["fog2", "uav4", "uav5", "uav6"]
    assert len(beyond(TOPOLOGY, "uav1", "fog1")) == 9


def test_every_frame_between_nodes_meets_exactly_one_link_on_each_hop() -> None:
    """On the interface of each node every other node's address is matched once, whatever link it leads to."""
    plan = resolve(read_profile("lossy"), TOPOLOGY, "scenario-1", 1)
    found = Counter(
        (match[1], match[2])
        for words in commands_of(plan, TOPOLOGY).begin
        if (match := re.search(r"dev @(\w+) ingress .* dst ([\d.]+)/32", " ".join(words)))
    )
    pairs = {(one.name, other.address) for one in TOPOLOGY.nodes for other in TOPOLOGY.nodes if one != other}
    assert found == dict.fromkeys(pairs, 1)


def test_links_that_leave_by_one_interface_have_a_device_each(tmp_path: Path) -> None:
    out = _about(
        _commands(tmp_path, "{air: {both: {delay: 5ms, source: s}}, backhaul: {both: {delay: 9ms, source: s}}}")
    )
    towards = [line.rpartition(" ")[2] for line in out if "@fog1 egress" in line]
    assert sorted(towards) == ["air-uav1-up", "air-uav2-up", "air-uav3-up", "back-fog1-down"]


def test_what_waits_for_its_delay_is_in_no_queue_of_the_rate(tmp_path: Path) -> None:
    links = "{air: {both: {rate: 1Mbit, queue: 60 packets, delay: 200ms, loss: 2%, source: s}}}"
    commands = _commands(tmp_path, links)
    (first,) = _about(commands, "parent 1:7 ", "netem")
    assert first.endswith("netem limit 60 rate 1000000bit")
    (second,) = _about(commands, "dev air-uav1-up root")
    assert re.search(r"netem limit \d+ delay 200000us loss 2% seed \d+$", second)
    assert "rate" not in second


def test_a_delay_stage_has_room_for_all_that_is_on_its_way(tmp_path: Path) -> None:
    for links, needed in (
        ("{air: {both: {delay: 600ms, source: s}}}", 60_000),
        ("{air: {both: {rate: 1Mbit, queue: 9 packets, delay: 600ms, jitter: 100ms, source: s}}}", 2_083),
    ):
        (line,) = _about(_commands(tmp_path, links), "dev air-uav1-up root")
        limit = re.search(r"limit (\d+)", line)
        assert limit is not None
        assert needed < int(limit[1]) < needed * 2


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        ("delay: 40ms, jitter: 5ms", "delay 40000us 5000us distribution normal rate 10000000000bit"),
        ("delay: 40ms, jitter: 5ms, distribution: uniform", "delay 40000us 5000us rate 10000000000bit"),
        ("delay: 40ms, jitter: 5ms, reordering: true", "delay 40000us 5000us distribution normal"),
        ("delay: 40ms, jitter: 5ms, distribution: pareto, reordering: true", "40000us 5000us distribution pareto"),
        ("delay: 40ms, reorder: 2%", "delay 40000us reorder 2%"),
        ("loss: 0.2%, duplicate: 1%, corrupt: 0.01%", "loss 0.2% duplicate 1% corrupt 0.01%"),
    ],
)
def test_order_is_kept_by_a_rate_unless_reordering_is_asked_for(tmp_path: Path, figures: str, words: str) -> None:
    (line,) = _about(_commands(tmp_path, f"{{air: {{both: {{{figures}, source: s}}}}}}"), "dev air-uav1-up root")
    assert re.search(rf"{words} seed \d+$", line), line


def test_a_shared_medium_is_a_parent_class_with_the_rate_and_a_queue_for_each_direction(tmp_path: Path) -> None:
    air = "{air: {shared: true, both: {rate: 64kbit, queue: 30 packets, source: s}}}"
    commands = _commands(tmp_path, air)
    assert len(_about(commands, "parent 1: classid 1:107 htb rate 64000bit")) == 1
    for leaf in ("1:7", "1:8"):
        assert len(_about(commands, f"parent 1:107 classid {leaf} htb", "ceil 64000bit")) == 1
        assert len(_about(commands, f"parent {leaf} ", "netem limit 30 rate 64000bit")) == 1


def test_an_outage_closes_and_then_sets_what_was_there_before(tmp_path: Path) -> None:
    events = "[{link: 'air:uav3:up', at: 20s, for: 5s, change: {closed: true}, source: s}]"
    timed = _commands(tmp_path, AIR, events).timed
    assert [at_s for at_s, _ in timed] == [20.0, 25.0]
    said = [re.sub(r" seed \d+", "", " ".join(words)) for _, words in timed]
    assert said[0] == "tc qdisc change dev air-uav3-up root handle 1: netem limit 5000 delay 40000us loss 100%"
    assert said[1] == "tc qdisc change dev air-uav3-up root handle 1: netem limit 5000 delay 40000us"


def test_events_that_overlap_add_up_and_end_one_by_one(tmp_path: Path) -> None:
    events = (
        "[{link: 'air:uav3:up', at: 20s, for: 9s, change: {loss: 20%}, source: s},"
        " {link: 'air:uav3:up', at: 22s, for: 2s, change: {closed: true}, source: s},"
        " {link: 'air:uav3:up', at: 23s, for: 9s, change: {delay: 80ms}, source: s}]"
    )
    link = next(each for each in directed_links(_plan(tmp_path, AIR, events), TOPOLOGY) if "uav3:up" in each.name)
    assert [(at_s, state.delay_us, state.loss, closed) for at_s, state, closed in link.states] == [
        (0.0, 40_000, 0.0, False),
        (20.0, 40_000, 0.2, False),
        (22.0, 40_000, 0.2, True),
        (23.0, 80_000, 0.2, True),
        (24.0, 80_000, 0.2, False),
        (29.0, 80_000, 0.0, False),
        (32.0, 40_000, 0.0, False),
    ]


def test_corruption_ends_with_its_event_though_netem_would_keep_it(tmp_path: Path) -> None:
    events = "[{link: 'air:uav3:up', at: 20s, for: 5s, change: {corrupt: 5%}, source: s}]"
    commands = _commands(tmp_path, AIR, events)
    (begin,) = _about(commands, "dev air-uav3-up root")
    assert "corrupt 0%" in begin
    assert ["corrupt 5%" in " ".join(words) for _, words in commands.timed] == [True, False]
    assert "corrupt 0%" in " ".join(commands.timed[1][1])


def test_a_change_of_the_rate_leaves_the_delay_alone(tmp_path: Path) -> None:
    events = "[{link: 'air:uav3:up', at: 20s, change: {rate: 1Mbit, queue: 5 packets}, source: s}]"
    timed = _commands(tmp_path, AIR, events).timed
    assert {(at_s, words[1], words[4]) for at_s, words in timed} == {
        (at_s, kind, "rate") for at_s in (20.0, 60.0) for kind in ("class", "qdisc")
    }
    assert "limit 5 rate 1000000bit" in " ".join(timed[1][1])


def test_a_link_that_only_an_event_shapes_is_prepared_from_the_beginning(tmp_path: Path) -> None:
    commands = _commands(tmp_path, "{}", "[{link: wan, at: 9s, for: 1s, change: {closed: true}, source: s}]")
    assert len(_about(commands, "netem")) == 2
    assert len(commands.timed) == 4


def test_devices_have_names_that_the_kernel_takes_and_everything_made_is_removed() -> None:
    for name in profile_names():
        commands = commands_of(resolve(read_profile(name), TOPOLOGY, "scenario-1", 1, 30), TOPOLOGY)
        made = {words[3] for words in commands.begin if words[:3] == ("ip", "link", "add")}
        assert all(len(device) <= 15 and "/" not in device for device in made)
        assert made == {words[3] for words in commands.end if words[0] == "ip"}
        hooked = {words[4] for words in commands.begin if words[-1] == "clsact"}
        assert hooked == {words[4] for words in commands.end if words[-1] == "clsact"}


def test_commands_are_lists_of_words_for_json(tmp_path: Path) -> None:
    data = _commands(tmp_path, AIR).to_data()
    assert data["begin"][0] == ["tc", "qdisc", "add", "dev", "@fog1", "clsact"]
    assert data["timed"] == []
    assert json.loads(json.dumps(data["links"]))["air:uav1:up"] == {
        "device": "air-uav1-up",
        "queue": None,
        "states": [{"at_s": 0.0, "closed": False, "words": [_netem_of(data, "air-uav1-up", "change")]}],
        "shut": [_shut("air-uav1-up", data)],
    }


def _netem_of(data: dict[str, Any], device: str, verb: str) -> list[str]:
    """What gives a device its netem, as it was made, or again."""
    (found,) = (words for words in data["begin"] if words[:5] == ["tc", "qdisc", "add", "dev", device])
    return ["tc", "qdisc", verb, *found[3:]]


def _shut(device: str, data: dict[str, Any]) -> list[str]:
    """The same but that everything is lost, with a seed of its own."""
    words = _netem_of(data, device, "change")
    (seed,) = (each[-1] for each in data["links"]["air:uav1:up"]["shut"])
    assert seed != words[-1]
    return [*words[:-2], "loss", "100%", "seed", seed]


def test_states_are_those_of_the_timed_changes(tmp_path: Path) -> None:
    outage = "[{link: air:uav1:up, at: 2s, for: 1s, change: {closed: true}, source: s}]"
    commands = _commands(tmp_path, AIR, outage)
    states = commands.links["air:uav1:up"].states
    assert [(state.at_s, state.closed) for state in states] == [(0.0, False), (2.0, True), (3.0, False)]
    assert [(state.at_s, state.words[-1]) for state in states[1:]] == list(commands.timed)


def test_with_always_every_link_has_both_stages_although_nothing_is_planned(tmp_path: Path) -> None:
    plan = _plan(tmp_path, "{}")
    commands = commands_of(plan, TOPOLOGY, always=True)
    assert set(commands.links) == set(plan.links)
    for link in commands.links.values():
        assert _about(commands, f"handle {link.queue} netem limit 1000 rate 10000000000bit")
        assert _about(commands, f"dev {link.device} root handle 1: netem limit 1000 corrupt 0% rate 10000000000bit")


def test_a_change_by_hand_names_every_figure_and_needs_no_other_stage(tmp_path: Path) -> None:
    plan = _plan(tmp_path, "{}")
    begun = commands_of(plan, TOPOLOGY, always=True)
    changed = replace(plan.links["air:uav3:up"], rate_bps=1_000_000, queue_packets=50, delay_us=200_000, loss=0.2)
    *rate, delay = change_words(plan, TOPOLOGY, "air:uav3:up", changed, False)
    made = {_object(words) for words in begun.begin}
    assert all(_object(words) in made for words in (*rate, delay))
    assert " ".join(rate[-1]).endswith("netem limit 50 rate 1000000bit")
    limit = 1000 + 1_000_000 // 480 * 0.2
    assert " ".join(delay[:-2]) == (
        f"tc qdisc change dev air-uav3-up root handle 1: netem limit {limit:.0f} delay 200000us loss 20%"
        " corrupt 0% rate 10000000000bit"
    )
    (*_, shut) = change_words(plan, TOPOLOGY, "air:uav3:up", plan.links["air:uav3:up"], True)
    assert "loss 100%" in " ".join(shut)


def _object(words: Words) -> tuple[str, ...]:
    """What a command makes or changes, without what it is told."""
    kind = next(
        place for place, word in enumerate(words) if word in ("netem", "htb", "type", "txqueuelen", "clsact", "action")
    )
    return (words[0], words[1], *words[3:kind])


def _typed(*words: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(cli.app, ["profiles", *words])
    return done.exit_code, done.stdout, done.stderr


def test_profiles_are_listed_with_a_line_each() -> None:
    code, out, _ = _typed()
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()] == profile_names()
    assert "a SiK telemetry radio to each drone, half duplex" in out


def test_show_prints_the_table_the_events_and_the_commands() -> None:
    code, out, _ = _typed("show", "leo")
    assert code == 0
    assert re.search(r"wan:gs:up +10Mbit +100 packets +25ms +5ms normal", out)
    assert re.search(r"air:uav1-6:down +- +- +2ms +1ms normal", out)
    assert re.search(r"5\.678 s +wan:gs:up +0\.500 s +closed", out)
    assert "\nip link add rate type ifb\n" in out
    assert "# at 5.678012 s\ntc qdisc change dev wan-gs-up" in out
    assert "nothing is shaped" not in out


def test_show_says_where_every_figure_comes_from() -> None:
    code, out, _ = _typed("show", "lte", "--sources")
    assert code == 0
    assert "tc_profiles/lte.yaml: links.air.both.loss = 0.2%: Loadero's 4G condition\n" in out
    assert "ip link add" not in out


def test_show_prints_the_plan_that_shapers_take() -> None:
    code, out, _ = _typed("show", "lte", "--json")
    assert code == 0
    assert out.startswith('{\n "version": 1,\n "profile": "lte",')


def test_ideal_has_no_commands() -> None:
    assert _typed("show", "ideal")[1].endswith("no command: nothing is shaped\n")


def test_the_sensors_links_are_shown_for_the_experiment_that_has_them(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text("description: slow sensors\nlinks: {sense: {both: {delay: 30ms, source: assumed}}}\n")
    assert "sense:" not in _typed("show", str(own))[1]
    code, out, _ = _typed("show", str(own), "--experiment", "scenario-4")
    assert code == 0
    assert re.search(r"sense:uav1-6:up +- +- +30ms ", out)
    assert "tc qdisc add dev @sensor1 " in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["show", "5g"], "PROFILE=5g: expected one of ideal, 3g"),
        (["show", "lte", "--attempt", "0"], "--attempt 0: expected a whole number from 1 to 99"),
        (["show", "lte", "--length", "60"], "--length 60: expected a time with its unit (us, ms, s), as 25ms"),
        (["show", "lte", "--length", "0s"], "--length 0s: expected more than 0s, at most 3600s"),
    ],
)
def test_a_wrong_name_or_option_is_one_line_and_exit_code_2(words: list[str], said: str) -> None:
    code, out, err = _typed(*words)
    assert (code, out) == (2, "")
    assert err.startswith(f"testbed: {said}")
    assert len(err.splitlines()) == 1


def test_the_folder_holds_profiles_and_their_schema() -> None:
    assert {path.suffix for path in FOLDER.iterdir()} == {".yaml", ".json"}

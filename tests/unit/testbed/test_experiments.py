"""What a person typed, checked: one line that names the option, its value and what was expected."""

from __future__ import annotations

from typing import Any

import pytest

from testbed.errors import UserError
from testbed.experiments import make_plan
from testbed.runner import settings_of

GOOD = {"experiment": "scenario-1", "attempts": "2", "arm": "thesis", "profile": "ideal", "protocols": "mqttxt"}


def test_a_good_plan() -> None:
    plan = make_plan(**GOOD)
    assert (plan.attempts, plan.arm.qos, plan.protocols) == (2, 0, ("mqttxt",))
    assert settings_of(plan) == {"QOS": "0", "STREAMS": "px4-onboard", "ENCODING_FLAG": ""}
    assert settings_of(plan, "json")["ENCODING_FLAG"] == "--json"


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"experiment": "scenario-9"}, "scenario=scenario-9: expected scenario-1"),
        ({"attempts": "0"}, "ATTEMPTS=0: expected a whole number from 1 to 99"),
        ({"attempts": "x"}, "ATTEMPTS=x: expected a whole number from 1 to 99"),
        ({"attempts": "٣"}, "ATTEMPTS=٣: expected a whole number from 1 to 99"),
        ({"attempts": ""}, "ATTEMPTS=: expected a whole number from 1 to 99"),
        ({"arm": "fast"}, "ARM=fast: expected thesis"),
        ({"profile": "lte"}, "PROFILE=lte: expected ideal"),
        ({"protocols": "mqttxt,carrier-pigeon"}, "PROTOCOLS=carrier-pigeon: expected mqttxt"),
    ],
)
def test_a_mistake_is_named(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError) as mistake:
        make_plan(**{**GOOD, **changed})
    assert str(mistake.value) == said
    assert mistake.value.exit_code == 2


def test_an_unknown_encoding_is_named() -> None:
    with pytest.raises(UserError, match="ENCODING=xml: expected one of cbor, json"):
        settings_of(make_plan(**GOOD), "xml")

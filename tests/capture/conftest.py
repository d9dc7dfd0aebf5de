"""Small plans and captures on the twin."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from capture.plan import Plan, plan_from
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

MATERIAL = "cook-torrance:kd=0.1,ks=0.5,m=0.2,ior=1.5"


@pytest.fixture
def make_plan() -> Callable[..., Plan]:
    """Return a maker of plans: by default three poses, one of them refused, with one dark frame each."""

    def make(**changes: Any) -> Plan:
        content: dict[str, Any] = {
            "plan": {"name": "brass", "sample": "sample1"},
            "darks": {"count": 1},
            "poses": [{"kind": "sweep", "theta_i_deg": [30], "theta_o_deg": [-30, 0, 30]}],
        }
        return plan_from(content | changes, "test")

    return make


@pytest.fixture(scope="module")
def twin() -> Iterator[Twin]:
    """Return a twin that is fast enough for tests."""
    with Twin({"sample1": MATERIAL}, seed=7, speed=200.0) as running:
        yield running

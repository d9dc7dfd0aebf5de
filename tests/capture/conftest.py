"""Small plans and captures on the twin."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from capture.plan import Plan, plan_from
from capture.run import capture
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

MATERIAL = "cook-torrance:kd=0.1,ks=0.5,m=0.2,ior=1.5"
CONTENT: dict[str, Any] = {
    "plan": {"name": "brass", "sample": "sample1"},
    "darks": {"count": 1},
    "poses": [{"kind": "sweep", "theta_i_deg": [30], "theta_o_deg": [-30, 0, 30]}],
}


@pytest.fixture
def make_plan() -> Callable[..., Plan]:
    """Return a maker of plans: by default three poses, one of them refused, with one dark frame each."""

    def make(**changes: Any) -> Plan:
        return plan_from(CONTENT | changes, "test")

    return make


@pytest.fixture(scope="module")
def twin() -> Iterator[Twin]:
    """Return a twin that is fast enough for tests."""
    with Twin({"sample1": MATERIAL}, seed=7, speed=200.0) as running:
        yield running


@pytest.fixture(scope="module")
def reference(twin: Twin, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an undisturbed session of the default plan."""
    out = tmp_path_factory.mktemp("reference") / "s"
    assert capture(plan_from(CONTENT, "test"), twin.rig, out).complete
    return out

"""Fixtures that every room's tests may use."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from rig.description import Rig

ROOT = Path(__file__).resolve().parents[1]

# Started in the background by a shell without job control, Ctrl-C is ignored, here and in every child.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the shared measurements beside the project; the test is skipped where there is none."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the shared measurements are not at hand")
    return folder


@pytest.fixture
def default_rig(tmp_path: Path) -> Rig:
    """Return the default machine, as if its rig file lay in the test's own folder."""
    from rig.description import default_rig as describe

    return describe(folder=tmp_path)

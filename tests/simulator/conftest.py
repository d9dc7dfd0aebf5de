"""Fixtures of the twin's tests."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from simulator.twin import Twin


@pytest.fixture(scope="module")
def twin() -> Iterator[Callable[..., Twin]]:
    """Start twins for a module's tests: `twin(materials, speed=50)`.

    Equal arguments give the same running twin, so that a module starts few of them; all end with the module.
    """
    from simulator.twin import Twin

    running: dict[str, Twin] = {}
    with contextlib.ExitStack() as stack:

        def start(materials: dict[str, str] | None = None, **options: Any) -> Twin:
            key = repr((sorted((materials or {}).items()), sorted(options.items())))
            if key not in running:
                running[key] = stack.enter_context(Twin(materials, **options))
            return running[key]

        yield start

"""What a person sees while work goes on."""

from __future__ import annotations

import time

from gonio.output import at_work


def test_long_work_is_told_and_short_work_is_not(capsys) -> None:
    """Catches a silent minute, and a line for work that was over at once."""
    with at_work("short", after_s=60.0):
        pass
    with at_work("long", after_s=0.01, every_s=0.01):
        time.sleep(0.1)
    captured = capsys.readouterr()
    assert "short" not in captured.err
    assert captured.err.count("long") >= 2
    assert captured.out == ""

"""The front door: start-up cost, exit codes, one-line errors."""

from __future__ import annotations

import subprocess
import sys

import pytest

from gonio import cli

HEAVY = (
    "numpy",
    "scipy",
    "cv2",
    "colour",
    "mitsuba",
    "xarray",
    "bluesky",
    "pydantic",
    "matplotlib",
    "rawpy",
    "serial",
)


def test_help_imports_nothing_heavy() -> None:
    """Catches a heavy import at the front door, which would make `gonio --help` slow."""
    code = (
        "import sys; from gonio.cli import main; main(['--help']); "
        "print(*sys.modules, sep='\\n', file=sys.stderr)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in run.stderr.split()}
    assert not loaded & set(HEAVY)
    assert "usage: gonio" in run.stdout


@pytest.mark.parametrize("name", sorted(cli.COMMANDS))
def test_every_command_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a listed command without a module, without help or without an example."""
    with pytest.raises(SystemExit) as end:
        cli.main([name, "--help"])
    assert end.value.code == 0
    assert "example:\n  gonio " in capsys.readouterr().out


def test_command_modules_are_light() -> None:
    """Catches a command module that imports heavy libraries before its command runs."""
    names = ", ".join(f"'{name}'" for name in cli.COMMANDS)
    code = (
        f"import sys, importlib\nfor n in [{names}]: importlib.import_module('gonio.commands.' + n)\n"
        "print(*sys.modules, sep='\\n')"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in run.stdout.split()}
    assert not loaded & set(HEAVY)


@pytest.mark.parametrize(
    "arguments", [["nonsense"], ["fit", "no-such-file.csv"], ["merge", "no-such-file.dng"]]
)
def test_bad_input_is_one_line_and_exit_code_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a traceback, a silent default or a wrong exit code on bad input."""
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.strip().splitlines()) == 1
    assert arguments[-1] in captured.err


def test_usage_errors_name_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an option error that does not say which command it belongs to."""
    with pytest.raises(SystemExit) as end:
        cli.main(["fit", "--no-such-option"])
    assert end.value.code == 2
    assert "gonio fit" in capsys.readouterr().err


def test_a_range_may_begin_below_zero() -> None:
    """Catches `--theta-o-deg -60:60:20` read as an unknown option."""
    tied = cli._with_negative_values(["--theta-o-deg", "-60:60:20", "--x", ".5", "-1", "--json", "-h"])
    assert tied == ["--theta-o-deg=-60:60:20", "--x", ".5", "-1", "--json", "-h"]

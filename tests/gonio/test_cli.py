"""The front door: start-up cost, exit codes, one-line errors."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from gonio import cli
from gonio.output import Progress, say

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


def _piped(arguments: list[str], output: int, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run gonio as a shell does, its output buffered, into an open file."""
    return subprocess.run(
        [sys.executable, "-m", "gonio.cli", *arguments],
        stdout=output,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": "", **environment},
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("buffered", ["", "1"])
@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["rig", "--help"]])
def test_a_reader_that_left_is_no_error(arguments: list[str], buffered: str) -> None:
    """Catches `gonio --help | head -1` that ends in a traceback."""
    reader, writer = os.pipe()
    os.close(reader)
    run = _piped(arguments, writer, PYTHONUNBUFFERED=buffered)
    os.close(writer)
    assert (run.returncode, run.stderr) == (0, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("buffered", ["", "1"])
def test_results_on_a_full_disk_are_an_error(buffered: str) -> None:
    """Catches `gonio ... > file` that loses its results and says that all is well."""
    with Path("/dev/full").open("wb") as full:
        run = _piped(["--help"], full.fileno(), PYTHONUNBUFFERED=buffered)
    assert run.returncode == 2
    assert len(run.stderr.splitlines()) == 1
    assert b"No space left" in run.stderr


def test_names_that_are_no_text_can_be_shown() -> None:
    """Catches an error message that fails because of the file name in it."""
    run = _piped(["fit", "\udcff.csv"], subprocess.DEVNULL, PYTHONIOENCODING="utf-8:strict")
    assert run.returncode == 2
    assert b"\\udcff.csv: no such file" in run.stderr


def test_what_nobody_foresaw_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a traceback before a person, or a defect that a developer cannot trace."""

    def run(_options: object) -> int:
        return int("one")

    module = SimpleNamespace(__doc__="", EXAMPLE="", configure=lambda _parser: None, run=run)
    monkeypatch.setattr(cli, "_command_module", lambda _name: module)
    monkeypatch.delenv(cli.TRACEBACK_VARIABLE, raising=False)
    assert cli.main(["fit"]) == cli.EXIT_DEFECT
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert "ValueError at test_cli.py:" in error
    monkeypatch.setenv(cli.TRACEBACK_VARIABLE, "1")
    with pytest.raises(ValueError, match="one"):
        cli.main(["fit"])


def test_work_goes_on_when_the_terminal_closes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a capture of hours that dies of a progress line that nobody reads."""
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w", buffering=1) as closed:
        monkeypatch.setattr(sys, "stderr", closed)
        say("text")
        Progress("capture", 1)()
        with pytest.raises(BrokenPipeError):
            closed.write("text\n")
        monkeypatch.undo()
        os.dup2(os.open(os.devnull, os.O_WRONLY), closed.fileno())

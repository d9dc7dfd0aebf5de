"""Every command that the README shows is run here, as it stands there, by a shell."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")

FOREIGN = "Other people's data"


def _sections() -> dict[str, list[str]]:
    """Commands of the README's shell blocks by the heading they stand under."""
    found: dict[str, list[str]] = {}
    for section in re.split(r"^## ", README, flags=re.MULTILINE)[1:]:
        blocks = re.findall(r"^```sh\n(.*?)^```", section, flags=re.MULTILINE | re.DOTALL)
        commands = [line.partition("  #")[0].strip() for block in blocks for line in block.splitlines()]
        found[section.splitlines()[0]] = [command for command in commands if command]
    return found


SECTIONS = _sections()


def _environment() -> dict[str, str]:
    # `make test` must not make these calls of make its children, which print and do other things.
    outside = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    return {**outside, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def _run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(  # noqa: S602 - as the reader's shell would
        command,
        shell=True,
        cwd=folder,
        env=_environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Path]:
    """Serve the README's twin in a folder of its own."""
    command = next(command for command in SECTIONS["Measure"] if command.startswith("gonio sim"))
    twin = subprocess.Popen(
        shlex.split(command), cwd=tmp_path, env=_environment(), stdout=subprocess.PIPE, text=True
    )
    assert twin.stdout is not None
    assert twin.stdout.readline()  # it says how to reach it once it serves
    yield tmp_path
    twin.send_signal(signal.SIGINT)
    twin.communicate(timeout=20)


@pytest.mark.render
def test_measuring(served: Path) -> None:
    """Catches a README whose way from the twin to the report does not work as written."""
    for command in SECTIONS["Measure"]:
        if not command.startswith("gonio sim"):
            _run(command, served)
    assert (served / "session" / "report.html").is_file()


@pytest.mark.realdata
def test_other_peoples_data(shared_data: Path, tmp_path: Path) -> None:
    """Catches a README whose commands for foreign files do not work as written."""
    flea3, rt300s = shared_data / "flea3", shared_data / "rt300s" / "raw"
    for file in (*flea3.glob("disks/disks_450nm_*"), *flea3.glob("dark/d1_*")):
        shutil.copy(file, tmp_path)
    shutil.copy(shared_data / "cornell" / "garnet_red.brdf", tmp_path)
    shutil.copy(next(rt300s.glob("*EC1*.xls")), tmp_path / "coating.xls")
    shutil.copy(rt300s / "blank_v2o0_20250911.xls", tmp_path / "blank.xls")
    for command in SECTIONS[FOREIGN]:
        _run(command, tmp_path)


def test_nothing_is_left_untested() -> None:
    """Catches a command added to the README under a heading that no test runs."""
    assert {name for name, commands in SECTIONS.items() if commands} == {"Try it", "Measure", FOREIGN}
    inline = re.findall(r"`(gonio [a-z]+[^`]*|make [a-z-]+)`", README)
    for command in inline:
        program, verb = command.split()[:2]
        if program == "make":
            assert re.search(rf"^{verb}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
        else:
            _run(f"gonio {verb} --help", ROOT)


def test_the_two_commands() -> None:
    """Catches a Makefile whose targets no longer do what the README promises."""
    assert SECTIONS["Try it"] == ["make demo", "make test"]
    recipes = {target: _run(f"make --dry-run {target}", ROOT).stdout for target in ("demo", "test")}
    assert recipes["demo"].strip().endswith("gonio demo")
    assert recipes["test"].strip().endswith("-m pytest")


@pytest.mark.slow
def test_make_demo_from_a_clone(tmp_path: Path) -> None:
    """Catches a clone that lacks something: `make demo` must set itself up and end with the report."""
    clone = tmp_path / "clone"
    _run(f"git clone --quiet {shlex.quote(str(ROOT))} {shlex.quote(str(clone))}", tmp_path)
    _run("make demo", clone)
    assert (clone / "gonio-demo" / "report.html").is_file()

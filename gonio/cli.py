"""The `gonio` command: finds the sub-command, runs it, turns errors into one line and an exit code.

Only the standard library is imported here; a command's module, and the heavy libraries behind it, are
imported when that command runs, so that `gonio --help` answers at once.
"""

from __future__ import annotations

import argparse
import importlib
import io
import os
import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING

from gonio.output import say
from rig.errors import BadInput, GonioError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import ModuleType

COMMANDS: dict[str, str] = {
    "demo": "the whole chain on the twin, with a report",
    "sim": "the twin of the rig, for any client",
    "rig": "the machine: check, move, park, stop",
    "plan": "poses to a TOML plan: grids, sweeps, lists",
    "capture": "run a plan into a session, or resume one",
    "calibrate": "the sensor from its own frames; the white from its certificate and points",
    "merge": "RAW brackets to radiance with variance",
    "reduce": "a session, or raw files by a recipe, to BRDF samples with uncertainty",
    "fit": "reflectance models to samples of any laboratory",
    "check": "samples of any laboratory: reciprocity, energy, symmetry, noise",
    "convert": "samples to another format, and what that loses",
    "report": "a session's page: coverage, lobes, parameters",
    "bench": "time against error, from a checkout",
}
"""Sub-commands and their one-line help; `gonio.commands.<name>` implements each."""

EXIT_INTERRUPTED = 130

EXIT_DEFECT = 1
"""Exit code of an error that nobody foresaw."""

TRACEBACK_VARIABLE = "GONIO_TRACEBACK"
"""Environment variable that shows a developer the whole of such an error."""


def _command_module(name: str) -> ModuleType:
    return importlib.import_module(f"gonio.commands.{name}")


def _overview() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {text}" for name, text in COMMANDS.items()]
    return "\n".join(
        [
            "usage: gonio COMMAND [options]",
            "",
            "Measures how a surface reflects light: drives the rig, merges, reduces, fits, reports.",
            "",
            *lines,
            "",
            "gonio COMMAND --help shows a command's options with an example; --version the version.",
        ]
    )


def _parser(name: str, module: ModuleType) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=f"gonio {name}",
        description=module.__doc__,
        epilog=f"example:\n  {module.EXAMPLE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.configure(parser)
    return parser


def _with_negative_values(arguments: Sequence[str]) -> list[str]:
    """Tie a value such as -60:60:15 to its option; argparse alone would take it for an option itself."""
    tied: list[str] = []
    for argument in arguments:
        negative = len(argument) > 1 and argument[0] == "-" and argument[1] in "0123456789."
        if negative and tied and tied[-1].startswith("--") and "=" not in tied[-1]:
            tied[-1] += f"={argument}"
        else:
            tied.append(argument)
    return tied


def main(argv: Sequence[str] | None = None) -> int:
    """Run one `gonio` command.

    Parameters
    ----------
    argv : sequence of str, optional
        The arguments after the program's name; by default those of the process.

    Returns
    -------
    int
        The exit code: 0 done, 2 bad input, 3 refused, 4 device lost, 5 unsafe, 130 Ctrl-C, 143 SIGTERM,
        1 an error that nobody foresaw.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    _escape_what_cannot_be_shown()
    try:
        code, message = _run(arguments)
    except SystemExit:  # argparse has shown its help, or its complaint
        _finish_output()
        raise
    complaint = message or _finish_output()
    if complaint:
        say(f"{' '.join(['gonio', *arguments[:1]])}: {complaint}")
    return code or (BadInput.exit_code if complaint else 0)


def _run(arguments: Sequence[str]) -> tuple[int, str]:
    """Run a command to its exit code and, where it failed, the one line that says why."""
    try:
        return _dispatch(arguments), ""
    except GonioError as error:
        return error.exit_code, _one_line(error)
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED, "interrupted"
    except BrokenPipeError:
        # The reader of our output left (`gonio ... | head`): nothing to tell it, no traceback at shutdown.
        _drop_output()
        return 0, ""
    except OSError as error:
        return BadInput.exit_code, _operating_system_error(error)
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        return EXIT_DEFECT, _defect(error)


def _dispatch(arguments: Sequence[str]) -> int:
    if not arguments or arguments[0] in {"-h", "--help", "help"}:
        print(_overview())
        return 0
    if arguments[0] == "--version":
        from importlib.metadata import version

        print(f"gonio {version('gonio')}")
        return 0
    name, *rest = arguments
    if name not in COMMANDS:
        raise BadInput("unknown command", todo="gonio --help lists the commands")
    module = _command_module(name)
    options = _parser(name, module).parse_args(_with_negative_values(rest))
    return int(module.run(options) or 0)


def _escape_what_cannot_be_shown() -> None:
    """Show a file name that is no text, or a letter that the terminal lacks, as an escape, not an error."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _finish_output() -> str:
    """Write out what is buffered while an error can still be said; the complaint, or nothing."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        _drop_output()
    except OSError as error:
        _drop_output()
        return _operating_system_error(error)
    return ""


def _drop_output() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _defect(error: Exception) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "gonio"
    return (
        f"unexpected {type(error).__name__} at {place}: {_one_line(error)}; this is a defect of gonio, "
        f"{TRACEBACK_VARIABLE}=1 shows where it comes from"
    )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _operating_system_error(error: OSError) -> str:
    what = error.strerror or _one_line(error) or type(error).__name__
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{what}; check the path, its permissions and the free space, then run the command again"


if __name__ == "__main__":
    sys.exit(main())

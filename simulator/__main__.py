"""`python -m simulator`: the twin's process, for programs; people start `gonio sim`."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from rig.errors import GonioError
from simulator.light_process import error_record
from simulator.options import add_twin_options, settings_from
from simulator.server import serve


def _say(record: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(record) + "\n")
    sys.stdout.flush()


def main() -> int:
    """Serve until standard input ends or a signal comes; a line of JSON says that it is ready, or why not."""
    parser = argparse.ArgumentParser(prog="python -m simulator", description=__doc__)
    add_twin_options(parser)
    try:
        serve(settings_from(parser.parse_args(), commands=sys.stdin.fileno()), _say)
    except GonioError as error:
        _say({"error": error_record(error)})
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())

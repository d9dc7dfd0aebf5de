"""Sets what `gonio bench fit --json --plots docs/models` printed into `docs/models.md`, as a section.

    gonio bench fit --json --plots docs/models > numbers.json
    python -m benchmarks.fit_page docs numbers.json [MORE.json ...]

Results of parts that were run alone can be given side by side. `benchmarks.models_page` keeps the section.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

from benchmarks.rows import met, table

HEAD = "## Numbers of the fits"
BEFORE = "## The models"
_SECTION = re.compile(rf"{HEAD}\n.*?(?=^## )", re.MULTILINE | re.DOTALL)

_TEXT = f"""{HEAD}

Written by `python -m benchmarks.fit_page docs numbers.json` from what `gonio bench fit --json` printed,
parts that were run again alone in place of their first rows. RMS is that of ln(1 + f cos(theta_i)); times
are processor times on one core; the plain fit is `scipy.optimize.least_squares` with a numeric Jacobian
from four starts, written in `benchmarks/fit_plain.py`.

![Error against time of fits to 20 materials, beside a plain fit](models/fit.png)
"""


def section(results: list[dict[str, Any]]) -> str:
    """Set rows of `gonio bench` as a section with one table."""
    return "\n".join([_TEXT, *table(results), "", met(results), "", ""])


def kept(page: str) -> str:
    """Return the section of an existing page; empty where it has none."""
    found = _SECTION.search(page)
    return found[0] if found else ""


def replaced(page: str, text: str) -> str:
    """Return a page with the section in place of its old one, or before the models."""
    if _SECTION.search(page):
        return _SECTION.sub(lambda _: text, page)
    return page.replace(f"{BEFORE}\n", f"{text}{BEFORE}\n", 1)


def main() -> int:
    """Write the section into the folder's page."""
    if len(sys.argv) < 3:
        print(__doc__)
        return 2
    page = Path(sys.argv[1]) / "models.md"
    results = [row for path in sys.argv[2:] for row in json.loads(Path(path).read_text("utf-8"))["results"]]
    page.write_text(replaced(page.read_text("utf-8"), section(results)), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Options that only some formats understand, the same in every command that reads samples."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import argparse

NAMES = ("blank", "floor_shift", "material", "as_published", "side", "no_cosine")
"""As the readers call them; a format that does not know one refuses it."""


def add_format_options(parser: argparse.ArgumentParser) -> None:
    """Add the options to a command."""
    group = parser.add_argument_group("formats")
    group.add_argument(
        "--blank", metavar="FILE", help="RT-300S: the measurement without a sample, subtracted"
    )
    group.add_argument(
        "--floor-shift",
        action="store_true",
        help="RT-300S: shift the smallest reading to 0, as some published tables did",
    )
    group.add_argument("--material", metavar="NAME", help="in-plane tables: which of several materials")
    group.add_argument(
        "--as-published",
        action="store_true",
        help="in-plane radiances: with the published formula's cosine inside",
    )
    group.add_argument("--side", metavar="SIDE", help="WINDOW: front or back of the layer")
    group.add_argument(
        "--no-cosine", action="store_true", help="RGL: the file's values have no cosine inside"
    )


def format_options(options: argparse.Namespace) -> dict[str, Any]:
    """Return what was given of them, for `analysis.samples.read`."""
    return {name: value for name in NAMES if (value := getattr(options, name)) not in (None, False)}

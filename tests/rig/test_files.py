"""Files are replaced whole or not at all."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from rig.errors import BadInput, Refused
from rig.files import whole_file


def test_a_file_is_made_and_replaced(tmp_path: Path) -> None:
    """Catches a file that does not appear, or leaves its other half behind."""
    path = tmp_path / "table.csv"
    for text in ("first", "second"):
        with whole_file(path) as place:
            assert place.suffix == ".csv"
            place.write_text(text)
        assert path.read_text() == text
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("error", "kind", "message"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), Refused, r"table\.csv: the disk is full"),
        (OSError("file write failed:\nerrno = 28, 'No space left on device'"), Refused, "the disk is full"),
        (OSError(errno.EIO, "Input/output error"), BadInput, r"table\.csv: cannot be written: Input/output"),
        (ValueError("ours"), ValueError, "ours"),
    ],
)
def test_what_was_there_outlives_a_failure(
    tmp_path: Path, error: Exception, kind: type[Exception], message: str
) -> None:
    """Catches results of an earlier run destroyed by one that failed."""
    path = tmp_path / "table.csv"
    path.write_text("earlier")

    def fail() -> None:
        with whole_file(path) as place:
            place.write_text("half")
            raise error

    with pytest.raises(kind, match=message) as caught:
        fail()
    assert "\n" not in str(caught.value)
    assert path.read_text() == "earlier"
    assert list(tmp_path.iterdir()) == [path]


def test_no_folder_is_one_line(tmp_path: Path) -> None:
    """Catches a message without the file's name."""
    path = tmp_path / "nowhere" / "table.csv"
    with pytest.raises(BadInput, match=r"table\.csv: cannot be written"), whole_file(path) as place:
        place.write_text("x")


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="no devices here")
def test_devices_and_links_stay_what_they_are(tmp_path: Path) -> None:
    """Catches `--out /dev/null`, as root, that turns the device into a file; and a link replaced by one."""
    with whole_file("/dev/null") as place:
        assert place == Path("/dev/null")
    (tmp_path / "real.csv").write_text("earlier")
    (tmp_path / "link.csv").symlink_to("real.csv")
    with whole_file(tmp_path / "link.csv") as place:
        place.write_text("new")
    assert (tmp_path / "link.csv").is_symlink()
    assert (tmp_path / "real.csv").read_text() == "new"

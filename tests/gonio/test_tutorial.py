"""The tutorial's code, run as it is printed."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from analysis.models import MODELS
from gonio.cli import main
from rig.angles import spherical_to_direction

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
HEADER = "incidence,viewing,azimuth,red,green,blue"


def code() -> str:
    """Return the tutorial's only block of Python."""
    (block,) = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    return block


def their_table() -> np.ndarray:
    """Return what another laboratory measured of an orange paint: degrees and 1/sr, with 2 % noise."""
    grid = np.meshgrid(
        [10.0, 25.0, 40.0, 55.0, 70.0], np.arange(0.0, 80.0, 3.0), [0.0, 5.0, 15.0, 60.0, 180.0]
    )
    incidence, viewing, azimuth = (axis.ravel() for axis in grid)
    wi = spherical_to_direction(np.radians(incidence), np.full(incidence.shape, np.pi))
    wo = spherical_to_direction(np.radians(viewing), np.radians(azimuth))
    model = MODELS["ggx"](kd=[0.6, 0.25, 0.05], ks=1.0, alpha=0.2, f0=0.04)
    noise = 1.0 + 0.02 * np.random.default_rng(0).standard_normal((incidence.size, 3))
    return np.column_stack([incidence, viewing, azimuth, model.evaluate(wi, wo) * noise])


def test_it_is_ten_lines() -> None:
    """Catches a tutorial that has grown."""
    lines = [line for line in code().splitlines() if line and not line.startswith(("import", "from"))]
    assert len(lines) == 10
    assert HEADER in TEXT


ORDERS = {
    "as gonio writes it": (",", ".", (0, 1, 2, 3, 4, 5, 6)),
    "columns in another order": (",", ".", (6, 3, 4, 0, 2, 5, 1)),
    "semicolons and decimal commas": (";", ",", (0, 2, 1, 3, 6, 5, 4)),
    "tabs": ("\t", ".", (4, 5, 6, 0, 1, 2, 3)),
}


def named_table(*, names: tuple[str, ...], layout: str, rows: np.ndarray) -> str:
    """Return the same measurement with gonio's column names, in some layout."""
    separator, point, order = ORDERS[layout]
    head = ("theta_i_deg", "theta_o_deg", "phi_o_deg", *names, "phi_i_deg")
    table = np.column_stack([rows, np.full(len(rows), 180.0)])
    lines = [separator.join(head[i] for i in order)]
    lines += [separator.join(f"{row[i]:.6f}".replace(".", point) for i in order) for row in table]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("layout", ORDERS)
def test_tables_of_other_laboratories_without_python(tmp_path: Path, capsys, layout: str) -> None:
    """Catches a column taken for another, or a separator that ends in a traceback or in other numbers."""
    path = tmp_path / "theirs.csv"
    names = ("f_r_650nm", "f_r_550nm", "f_r_450nm")
    path.write_text(named_table(names=names, layout=layout, rows=their_table()), "utf-8")
    arguments = ["fit", str(path), "--model", "ggx", "--wavelength-nm", "550", "450", "--json"]
    assert main(arguments) == 0
    (result,) = json.loads(capsys.readouterr().out)["fits"]
    assert [name.replace(" ", "") for name in result["channels"]] == ["550nm", "450nm"]
    assert result["parameters"]["kd"]["value"] == pytest.approx([0.25, 0.05], abs=0.005)
    assert result["parameters"]["alpha"]["value"] == pytest.approx(0.2, rel=0.02)
    assert main([*arguments[:4], "--wavelength-nm", "600"]) == 2
    assert "holds no 600 nm; choose from" in capsys.readouterr().err


def test_a_table_in_radians_is_refused(tmp_path: Path, capsys) -> None:
    """Catches a fit of a lobe a degree wide, which is what radians look like as degrees."""
    rows = their_table()
    rows[:, :3] = np.radians(rows[:, :3])
    path = tmp_path / "theirs.csv"
    names = ("f_r_R", "f_r_G", "f_r_B")
    path.write_text(named_table(names=names, layout="as gonio writes it", rows=rows), "utf-8")
    assert main(["fit", str(path)]) == 2
    assert "looks like radians" in capsys.readouterr().err


@pytest.mark.render
def test_from_a_table_to_a_picture(tmp_path: Path) -> None:
    """Catches a tutorial that no longer runs, takes another model, or renders another colour."""
    np.savetxt(tmp_path / "theirs.csv", their_table(), delimiter=",", header=HEADER, comments="")
    run = subprocess.run(
        [sys.executable, "-c", code()], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
    )
    assert run.returncode == 0, run.stderr
    words, parameters, _, message = run.stdout.split("\n")[:4]
    assert words.startswith("on incidences it has not seen ggx errs by")
    assert float(re.findall(r"'alpha': array\(([\d.]+)\)", parameters)[0]) == pytest.approx(0.2, rel=0.02)
    assert message == ""
    from matplotlib.image import imread

    picture = imread(tmp_path / "fit.png")[..., :3]
    assert picture.shape == (256, 256, 3)
    red, green, blue = picture[100:156, 100:156].mean(axis=(0, 1))
    assert red > green > blue > 0.0
    assert picture[0, 0].max() == 0.0
